"""Predictions: images of a dataset's contacts by a calibration, with its effects."""

from skincal.prediction.places import ObservedImages, Places, best_places
from skincal.prediction.prediction import Mismatch, Prediction, predict_dataset
from skincal.prediction.session_samples import pose_names

__all__ = [
    "Mismatch", "ObservedImages", "Places", "Prediction", "best_places", "pose_names", "predict_dataset",
]  # fmt: skip
