"""Refinement of paths: nonlinear programmes, their solvers and residuals."""
