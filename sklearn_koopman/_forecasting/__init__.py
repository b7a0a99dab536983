"""What the forecaster of whole recordings is made of."""
