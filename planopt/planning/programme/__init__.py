"""Refining a path: nonlinear programmes, their solver and their residuals."""
