"""skincal: calibrate the simulation of a tactile skin against the real one.

What a notebook or a script needs is here by name (:mod:`skincal.api`), imported when it is first asked for::

    import skincal

    session = skincal.read_dataset("session")
    found = skincal.fit(session)
    skincal.plot(found, "valley", dataset=session)
"""

from typing import TYPE_CHECKING

from skincal.version import __version__

if TYPE_CHECKING:
    from skincal.api import (
        Skin,
        diagnose,
        export_ranges,
        fit,
        plot,
        predict,
        read_calibration,
        read_dataset,
        skin_of,
        write_calibration,
        write_dataset,
    )

__all__ = [
    "Skin", "__version__", "diagnose", "export_ranges", "fit", "plot", "predict", "read_calibration",
    "read_dataset", "skin_of", "write_calibration", "write_dataset",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'skincal' has no attribute '{name}'")
    from skincal import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return __all__
