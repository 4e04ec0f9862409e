"""A skin on a GPU: batches of presses with closed-form indenters; inputs and outputs are device arrays."""

from __future__ import annotations

import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np

from skincal.errors import WorkError, input_error, text_of
from skincal.model.arrays import FloatArray, check_shape
from skincal.model.gpu.target import Precision
from skincal.model.indenters.indenter import ClosedForm, Indenter
from skincal.model.skin import Skin

EXTRA = "pip install 'skincal[gpu]'"
_DLPACK_CUDA = 2
"""CUDA's device type in DLPack."""
_BLOCKS = 16
"""Blocks per multiprocessor: more than can be resident at once."""
_SCRATCH = 2**28
"""Largest scratch memory [bytes], for presses that touch more points than shared memory holds."""


@dataclass(frozen=True, eq=False)
class DeviceResponse:
    """Tactile images of K presses, as device arrays with ``__cuda_array_interface__``.

    Attributes:
        image: (K, J) [counts], through the converter; NaN where a press is not known.
        penetration_m: (K,) [m].
        status: (K,) values of :class:`skincal.model.Status`, 32 bits.
    """

    image: Any
    penetration_m: Any
    status: Any


class DeviceSkin:
    """A skin and an indenter on a GPU.

    Images equal those of :meth:`skincal.model.Skin.image` up to rounding: about 1e-6 of the largest value in single
    precision. No press raises an error; the ``status`` of a :class:`DeviceResponse` marks invalid presses.

    Args:
        skin: the skin.
        indenter: a closed-form indenter. Meshes need :class:`skincal.model.Skin`.
        precision: of all arithmetic on the device, ``"single"`` or ``"double"``.
        block: number of threads per press, a power of two.

    Raises:
        InputError: the extra is not installed, there is no GPU, the indenter is a mesh, or the skin has a contact law.
    """

    def __init__(
        self, skin: Skin, indenter: Indenter, *, precision: Precision = "single", block: int = 128
    ) -> None:
        self._cuda = cuda = require_gpu()
        fix = "Press it on the processor, with Skin.image."
        if not isinstance(indenter, ClosedForm):
            raise input_error("DeviceSkin", "an indenter in closed form", str(indenter), fix)
        if skin.contact is not None:
            expected = "a skin without a contact law of its own"
            raise input_error("DeviceSkin", expected, str(skin.contact), fix)
        from skincal.model.gpu import kernel
        from skincal.model.gpu.target import Target

        # Shared memory holds half as many numbers in double precision.
        near = kernel.POINTS if precision == "single" else kernel.POINTS // 2
        target = Target(precision, BLOCK=block, POINTS=near)
        self._kernel, self._block, self._real = target.kernel(kernel.press), block, target.real
        tiled, law, converter = skin.patch.tiled, skin.law, skin.converter
        # Single precision needs coordinates relative to the middle of the patch, not to the finger's origin.
        middle = tiled.tiles[:3].mean(axis=1)
        points, tiles = tiled.points.copy(), tiled.tiles.copy()
        points[:3] -= middle[:, None]
        tiles[:3] -= middle[:, None]
        self.taxels = skin.patch.layout.taxels
        scale = np.broadcast_to(np.asarray(skin.parameters.scale_per_n), (self.taxels,))
        self._patch_args = (
            self._put(points), cuda.to_device(tiled.taxel.astype(np.int32)),
            cuda.to_device(tiled.border.astype(np.int8)), self._put(tiles), cuda.to_device(middle),
            indenter.kind, self._real(indenter.radius_m),
            self._real(min(indenter.depth_m, skin.patch.depth_m)),
        )  # fmt: skip
        low, high = converter.value_min, converter.value_max
        self._skin_args = (
            self._real(skin.parameters.elasticity_pa_per_m), self._real(1.0 if law is None else law.exponent),
            self._real(1.0 if law is None else law.reference_m), self._put(scale),
            self._real(-np.inf if low is None else low), self._real(np.inf if high is None else high),
            converter.integer,
        )  # fmt: skip
        count, tile_count = points.shape[1], tiles.shape[1]
        blocks = _BLOCKS * _multiprocessors(cuda)
        if count > near or tile_count > kernel.TILES:
            block_bytes = 4 * (count * (1 + 3 * self._real().itemsize // 4) + tile_count)
            blocks = max(1, min(blocks, _SCRATCH // block_bytes))
        self._blocks = blocks
        self._scratch = (
            self._empty((blocks, 3, count)), self._empty((blocks, count), np.int32),
            self._empty((blocks, tile_count), np.int32),
        )  # fmt: skip

    def respond(
        self, normals: Any, origins_m: Any, force_n: Any, rotations: Any = None, *, image: Any = None
    ) -> DeviceResponse:
        """Simulate K presses.

        numpy arrays are copied to the device. Device arrays with ``__cuda_array_interface__`` (PyTorch, CuPy, JAX,
        Warp, Numba) or ``__dlpack__`` are used in place.

        Args:
            normals: (K, 3) unit contact normals n_c, fingertip frame; not checked.
            origins_m: (K, 3) origins of the indenter's frame [m]; the contact points if ``rotations`` is None.
            force_n: (K,) normal forces [N].
            rotations: (K, 3, 3) from the indenter's frame to the fingertip's; None: the default of
                :class:`skincal.model.Contacts`.
            image: (K, J) device array for the images, in the precision of this skin; None: a new one is allocated.

        Returns:
            Images, penetrations and statuses. The kernel may still be running; later reads on the same stream wait for
            it.

        Raises:
            ValueError: shapes do not match, or ``image`` has another type.
            WorkError: the device has not enough memory for the results.
        """
        force = self._as_device_array("force_n", force_n, (None,))
        count = force.shape[0]
        normal = self._as_device_array("normals", normals, (count, 3))
        origin = self._as_device_array("origins_m", origins_m, (count, 3))
        matrices = self._empty((1, 9))
        if rotations is not None:
            matrices = self._as_device_array("rotations", rotations, (count, 3, 3)).reshape(count, 9)
        out = self._empty((count, self.taxels)) if image is None else self._checked_image(image, count)
        depth, status = self._empty((count,)), self._empty((count,), np.int32)
        if count:
            self._kernel[min(count, self._blocks), self._block](
                *self._patch_args, normal, origin, matrices, rotations is not None, force, *self._skin_args,
                *self._scratch, out, depth, status,
            )  # fmt: skip
        return DeviceResponse(out, depth, status)

    def _empty(self, shape: tuple[int, ...], dtype: Any = None) -> Any:
        """Return an uninitialised device array.

        Raises:
            WorkError: the device has not enough memory.
        """
        dtype = np.dtype(self._real if dtype is None else dtype)
        try:
            return self._cuda.device_array(shape, dtype)
        except Exception as error:
            # numba's own error has no public base class.
            if type(error).__name__ not in ("MemoryError", "CudaAPIError"):
                raise
            size = np.prod(shape) * dtype.itemsize / 1e6
            fix = "Press fewer at once, or free memory of the device."
            raise WorkError(
                f"GPU: expected {size:.3g} MB of free memory; got: {text_of(error)}. {fix}"
            ) from None

    def _put(self, values: FloatArray) -> Any:
        return self._cuda.to_device(np.ascontiguousarray(values, dtype=self._real))

    def _as_device_array(self, name: str, value: Any, shape: tuple[int | None, ...]) -> Any:
        """Return a device array of the given shape, without a copy if it is one already."""
        array = _on_device(self._cuda, value)
        check_shape(name, array, shape)
        return array

    def _checked_image(self, image: Any, count: int) -> Any:
        """Return the caller's image array, checked for type and memory layout."""
        array = self._as_device_array("image", image, (count, self.taxels))
        if array.dtype != self._real:
            raise ValueError(f"image: expected {np.dtype(self._real)}; got {array.dtype}")
        size = np.dtype(self._real).itemsize
        if count and tuple(array.strides) != (size * self.taxels, size):
            raise ValueError("image: expected an array with contiguous rows; got a view of another")
        return array


def require_gpu() -> Any:
    """Return the package ``numba.cuda`` after checking that it can use a GPU.

    Raises:
        InputError: the extra is not installed, or there is no GPU.
    """
    from numba.core import config

    simulated = bool(getattr(config, "ENABLE_CUDASIM", False))
    if not simulated and importlib.util.find_spec("numba_cuda") is None:
        raise input_error("GPU", "the package numba-cuda", "none", f"Install it with: {EXTRA}")
    from skincal.model.gpu.target import cuda

    if not cuda.is_available():
        fix = "Run it on a machine with an NVIDIA GPU and its driver, or press on the processor, with Skin.image."
        raise input_error("GPU", "an NVIDIA GPU that CUDA can use", "none", fix)
    return cuda


def _on_device(cuda: Any, value: Any) -> Any:
    if hasattr(value, "copy_to_host"):
        return value
    if hasattr(value, "__cuda_array_interface__"):
        return cuda.as_cuda_array(value)
    if hasattr(value, "__dlpack_device__") and value.__dlpack_device__()[0] == _DLPACK_CUDA:
        found, _ = importlib.import_module("numba.cuda.cudadrv.devicearray").auto_device(value)
        return found
    array = np.ascontiguousarray(value)
    return cuda.to_device(array if array.dtype == np.float32 else array.astype(np.float64))


def _multiprocessors(cuda: Any) -> int:
    device = cuda.get_current_device() if hasattr(cuda, "get_current_device") else None
    return int(getattr(device, "MULTIPROCESSOR_COUNT", 1))
