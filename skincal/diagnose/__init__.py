"""From datasets, calibrations and plans to what the data can tell of a gap between simulation and measurement."""

from skincal.diagnose.audit import AuditReport, audit_dataset, audit_plan
from skincal.diagnose.base import calibrated_model, floor_of, guessed_model
from skincal.diagnose.plan import plan_session
from skincal.diagnose.session import gap_session, repeats
from skincal.predict.sites import sites

__all__ = [
    "AuditReport",
    "audit_dataset",
    "audit_plan",
    "calibrated_model",
    "floor_of",
    "gap_session",
    "guessed_model",
    "plan_session",
    "repeats",
    "sites",
]
