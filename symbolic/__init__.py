"""Spec file -> CasADi expressions -> C text and manifest. The only package that imports casadi."""
