"""Kernel matrices, and functions that are sums of kernel sections."""
