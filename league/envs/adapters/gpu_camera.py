"""Learners' pictures on a GPU: descriptions of what cameras see go there, and rays are cast there.

It is the code of league/sim/camera/raycast.py, compiled for CUDA by numba-cuda. Other parts of the
league do without this package: where it is missing, pictures are painted on the CPU and copied.
"""

import math
from functools import cache
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor

from league.sim.camera import raycast, visual_randomization
from league.sim.camera.raycast import Describer
from league.sim.config import CameraConfig

_THREADS = 128  # of a block


def available(device: torch.device) -> bool:
    """Return whether rays can be cast on a device."""
    return device.type == "cuda" and find_spec("numba_cuda") is not None


class GpuCamera:
    """Casts the rays of one camera in many worlds."""

    def __init__(self, describer: Describer, camera: CameraConfig, device: torch.device) -> None:
        """Copy the tables that the camera reads to the device."""
        self._camera, self._channels = camera, describer.channels
        self._first_thing, self._randomises = describer.first_thing, describer.randomises
        with torch.cuda.device(device):
            on_device = [torch.from_numpy(part).to(device) for part in describer.scenery()]
            self._scenery = raycast.Scenery(*map(_shared, on_device))
        grain = visual_randomization.grain(math.prod(camera.shape))
        self._grain = torch.from_numpy(grain).to(device)

    def pictures(self, rows: Tensor) -> Tensor:
        """Return the pictures of descriptions on the device.

        Args:
            rows: descriptions, newest first, float32 (num_rows, num_frames, 1, size).

        Returns:
            Pictures as a Renderer makes them, newest first, uint8 (num_rows, num_frames * channels,
            height, width).
        """
        cfg, flat = self._camera, rows.reshape(-1, rows.shape[-1]).contiguous()
        shape = (len(flat), cfg.num_eyes, cfg.height, cfg.width, self._channels)
        pictures = torch.empty(shape, dtype=torch.uint8, device=rows.device)
        cast, develop = _kernels()
        num_pixels = pictures.numel() // self._channels
        _launch(cast, num_pixels, flat, self._first_thing, self._scenery, pictures)
        if self._randomises:
            taken, pictures = pictures, torch.empty_like(pictures)
            _launch(develop, num_pixels, flat, self._grain, taken, pictures)
        channels_first = pictures.permute(0, 1, 4, 2, 3)
        return channels_first.reshape(len(rows), -1, cfg.height, cfg.width)


def _cuda() -> Any:  # noqa: ANN401
    from numba import cuda  # late: few runs have a GPU

    return cuda


def _shared(tensor: Tensor) -> Any:  # noqa: ANN401
    """Return a tensor's memory as numba-cuda takes it."""
    return _cuda().as_cuda_array(tensor, sync=False)


def _launch(kernel: Any, num_pixels: int, rows: Tensor, *arguments: Any) -> None:  # noqa: ANN401
    """Start a kernel after what torch has begun on its stream of this device."""
    given = [_shared(one) if isinstance(one, Tensor) else one for one in (rows, *arguments)]
    with torch.cuda.device(rows.device):
        stream = _cuda().external_stream(torch.cuda.current_stream().cuda_stream)
        kernel[-(-num_pixels // _THREADS), _THREADS, stream](*given)


@cache
def _kernels() -> tuple[Any, Any]:
    """Return the compiled kernels, a thread for each pixel; compiling takes a few seconds."""
    cuda = _cuda()

    @cuda.jit
    def cast(rows: Any, first_thing: Any, scenery: Any, pictures: Any) -> None:  # noqa: ANN401
        number = cuda.grid(1)
        if number < pictures.size // pictures.shape[4]:
            raycast.cast_pixel(number, rows, first_thing, scenery, pictures)

    @cuda.jit
    def develop(rows: Any, grain: Any, taken: Any, pictures: Any) -> None:  # noqa: ANN401
        number = cuda.grid(1)
        if number < pictures.size // pictures.shape[4]:
            raycast.develop_pixel(number, rows, grain, taken, pictures)

    return cast, develop
