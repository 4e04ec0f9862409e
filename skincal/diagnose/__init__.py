"""From datasets, calibrations and plans to what the data can tell of a gap between simulation and measurement."""

from skincal.diagnose.audit import AuditReport, audit_dataset, audit_plan
from skincal.diagnose.plan import plan_session
from skincal.diagnose.session import gap_session, repeats
from skincal.predict.sites import sites

__all__ = ["AuditReport", "audit_dataset", "audit_plan", "gap_session", "plan_session", "repeats", "sites"]
