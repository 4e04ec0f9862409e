"""Audit and diagnosis of datasets: what the data show about the gap between simulation and measurement."""

from skincal.diagnosis.audit import AuditReport, audit_dataset, audit_plan
from skincal.diagnosis.dataset_session import gap_session, repeats
from skincal.diagnosis.planned_session import plan_session
from skincal.prediction.session_samples import sites

__all__ = ["AuditReport", "audit_dataset", "audit_plan", "gap_session", "plan_session", "repeats", "sites"]
