"""Predicted surfacings, their scores, and the flight-model error behind them."""
