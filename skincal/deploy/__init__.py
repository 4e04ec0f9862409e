"""Run a policy on a hand through its driver and the guard, and record the run as a session.

Needs the core install and onnxruntime, but neither a learning library nor Gymnasium.
"""

from skincal.deploy.handover import DeployOptions
from skincal.deploy.policy_run import Deployed, deploy
from skincal.deploy.record import Record, write_record
from skincal.deploy.targets import letters, marble_targets, targets_of

__all__ = [
    "DeployOptions", "Deployed", "Record", "deploy", "letters", "marble_targets", "targets_of", "write_record",
]  # fmt: skip
