"""What a calibration says of presses: images predicted for the contacts of a dataset, its effects included."""

from skincal.predict.mismatch import Mismatch
from skincal.predict.places import Places, Seen, best_places
from skincal.predict.prediction import Prediction, predict_dataset
from skincal.predict.samples import pose_names

__all__ = ["Mismatch", "Places", "Prediction", "Seen", "best_places", "pose_names", "predict_dataset"]
