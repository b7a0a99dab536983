"""What the forecaster of recordings needs besides a regressor."""
