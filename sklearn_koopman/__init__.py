"""Koopman operators from motion data, as scikit-learn estimators."""

__version__ = "0.1.0"
