"""Free paths of a vehicle with a bounded speed."""
