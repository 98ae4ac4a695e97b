"""Manifest -> compiled functions -> fixed-rate loop and simulation. numpy and cffi, no casadi."""
