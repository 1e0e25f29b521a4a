"""Devices that networks run on: the execution providers of onnxruntime, by name."""

from __future__ import annotations

from fgpose.parameters import Device as Device

CPU = "CPUExecutionProvider"
_PROVIDERS: dict[Device, str] = {
    "cpu": CPU,
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "directml": "DmlExecutionProvider",
}
# Each of these comes with a wheel that somebody chose. TensorRT is not among them as it may build engines for minutes
# before the first image, CoreML as it comes with the usual wheel of macOS and may compute with 16 bits.
_AUTOMATIC: tuple[Device, ...] = ("cuda", "directml", "openvino", "cpu")
_WHEELS: dict[Device, str] = {
    "cuda": "the wheel onnxruntime-gpu, in place of onnxruntime",
    "tensorrt": "the wheel onnxruntime-gpu, in place of onnxruntime",
    "openvino": "the wheel onnxruntime-openvino, in place of onnxruntime",
    "coreml": "the wheel of onnxruntime for macOS",
    "directml": "the wheel onnxruntime-directml for Windows, in place of onnxruntime",
}


def available_devices() -> tuple[Device, ...]:
    """Those whose provider is in the onnxruntime that is installed; cpu is in all. Whether another starts shows when a
    network is opened: its drivers may be missing."""
    import onnxruntime

    providers = onnxruntime.get_available_providers()
    return tuple(device for device, provider in _PROVIDERS.items() if provider in providers)


def chosen_device(device: Device) -> Device:
    """The device itself, or what auto takes here.

    Raises:
        ValueError: there is no such device, or it is not available; the message says what is, and what brings it.
    """
    available = available_devices()
    if device == "auto":
        return next(each for each in _AUTOMATIC if each in available)
    if device not in _PROVIDERS:
        raise ValueError(f"no device {device!r}; there is auto, {', '.join(_PROVIDERS)}")
    if device not in available:
        raise ValueError(
            f"device {device}: this onnxruntime has no {_PROVIDERS[device]}; it has {', '.join(available)}."
            f" {_PROVIDERS[device]} comes with {_WHEELS[device]}"
        )
    return device


def providers_of(device: Device) -> list[str]:
    """What onnxruntime is given for a device that is available, the preferred first: the processor takes the operators
    that the others do not know, CUDA those that TensorRT does not.

    Raises:
        ValueError: as chosen_device.
    """
    chosen = chosen_device(device)
    wanted: tuple[Device, ...] = ("tensorrt", "cuda", "cpu") if chosen == "tensorrt" else (chosen, "cpu")
    return [_PROVIDERS[each] for each in dict.fromkeys(wanted) if each in available_devices()]


def device_of(provider: str) -> str:
    """Name of the device of a provider; of one that has none, its own."""
    return next((device for device, known in _PROVIDERS.items() if known == provider), provider)
