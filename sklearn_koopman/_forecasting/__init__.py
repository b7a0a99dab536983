"""Forecasts of whole recordings: what the forecaster is made of."""
