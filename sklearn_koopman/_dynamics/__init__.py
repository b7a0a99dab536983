"""Koopman operators on the span of kernel sections."""
