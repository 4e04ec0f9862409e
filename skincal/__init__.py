"""skincal: calibrate the simulation of a tactile skin against the real one."""

__version__ = "0.1.0"
