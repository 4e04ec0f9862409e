"""From a dataset to a calibration: the fit, with workers, checkpoints and file formats."""

from skincal.calibrate.dataset_fit import Outcome, calibrate
from skincal.calibrate.problem import METHODS, Method, Way, choose_way, fit_problem, search_box
from skincal.calibrate.uniform_fit import UniformOutcome, calibrate_uniform

__all__ = [
    "METHODS", "Method", "Outcome", "UniformOutcome", "Way", "calibrate", "calibrate_uniform", "choose_way",
    "fit_problem", "search_box",
]  # fmt: skip
