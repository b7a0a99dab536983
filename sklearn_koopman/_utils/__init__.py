"""What every room uses, and no mathematics of the package."""
