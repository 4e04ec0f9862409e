"""From datasets, calibrations and plans to what the data can tell of a gap between simulation and measurement."""
