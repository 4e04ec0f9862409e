"""The skin model on a GPU; needs the extra ``skincal[gpu]``, which is imported when a :class:`DeviceSkin` is made."""

from skincal.model.gpu.device_skin import DeviceResponse, DeviceSkin

__all__ = ["DeviceResponse", "DeviceSkin"]
