"""Systems with Gram matrices: from values at centres to coefficients."""
