"""Mean currents between fixes."""
