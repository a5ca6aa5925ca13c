"""Predicted surfacings, their scores, and the error of the flight model that they rest on."""
