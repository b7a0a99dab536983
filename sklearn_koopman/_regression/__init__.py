"""What the regressors need besides a system of equations."""
