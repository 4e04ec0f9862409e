"""Safe files: input is a plain file in its folder; output appears complete and replaces only earlier output."""

from skincal.files.inputs import check_input, open_input, real, reason
from skincal.files.locks import alone, recover
from skincal.files.outputs import reserved_room, whole_file, whole_folder
from skincal.files.refusals import refuse_existing

__all__ = [
    "alone", "check_input", "open_input", "real", "reason", "recover", "refuse_existing", "reserved_room", "whole_file",
    "whole_folder",
]  # fmt: skip
