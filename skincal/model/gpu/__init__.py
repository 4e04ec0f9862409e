"""The skin model on a GPU; needs the extra ``skincal[gpu]``. Nothing of it is imported before a :class:`DeviceSkin`."""

from skincal.model.gpu.device_skin import DeviceResponse, DeviceSkin

__all__ = ["DeviceResponse", "DeviceSkin"]
