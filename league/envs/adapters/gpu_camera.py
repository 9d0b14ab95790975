"""Learners' pictures on a GPU: descriptions of what cameras see go there, and rays are cast there.

It is the code of league/sim/camera/raycast.py, compiled for CUDA by numba-cuda. Other parts of the
league do without this package: where it is missing, pictures are painted on the CPU and copied.
"""

import math
from typing import Any

import torch
from numba import cuda as _numba_cuda
from torch import Tensor

from league.sim.camera import raycast, visual_randomization
from league.sim.camera.raycast import Describer
from league.sim.config import CameraConfig, SimConfig, VisualRandomization
from league.track.track import TrackSet

cuda: Any = _numba_cuda
cuda.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # small batches are no mistake
_THREADS = 128  # of a block


class GpuCamera:
    """Casts the rays of one camera in many worlds."""

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: VisualRandomization | None,
        device: torch.device,
    ) -> None:
        """Copy the tables that the camera reads to the device."""
        self._camera = camera
        self.describer = Describer(tracks, sim, camera, looks)
        """The renderer of cars that see through this camera; `pictures` takes what it returns."""
        with torch.cuda.device(device):
            on_device = [torch.from_numpy(part).to(device) for part in self.describer.scenery()]
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
        cfg, describer = self._camera, self.describer
        flat = rows.reshape(-1, rows.shape[-1]).contiguous()
        shape = (len(flat), cfg.num_eyes, cfg.height, cfg.width, describer.channels)
        pictures = torch.empty(shape, dtype=torch.uint8, device=rows.device)
        num_pixels = pictures.numel() // describer.channels
        _launch(_cast, num_pixels, flat, describer.first_thing, self._scenery, pictures)
        if describer.randomises:
            taken, pictures = pictures, torch.empty_like(pictures)
            _launch(_develop, num_pixels, flat, self._grain, taken, pictures)
        channels_first = pictures.permute(0, 1, 4, 2, 3)
        return channels_first.reshape(len(rows), -1, cfg.height, cfg.width)


def _shared(tensor: Tensor) -> Any:  # noqa: ANN401
    """Return a tensor's memory as Numba takes it."""
    return cuda.as_cuda_array(tensor, sync=False)


def _launch(kernel: Any, num_pixels: int, rows: Tensor, *arguments: Any) -> None:  # noqa: ANN401
    """Start a kernel after what torch has begun on its stream of this device."""
    given = [_shared(one) if isinstance(one, Tensor) else one for one in (rows, *arguments)]
    with torch.cuda.device(rows.device):
        stream = cuda.external_stream(torch.cuda.current_stream().cuda_stream)
        kernel[-(-num_pixels // _THREADS), _THREADS, stream](*given)


# A thread for each pixel; each is compiled at its first call, in a few seconds.


@cuda.jit
def _cast(rows: Any, first_thing: Any, scenery: Any, pictures: Any) -> None:  # noqa: ANN401
    number = cuda.grid(1)
    if number < pictures.size // pictures.shape[4]:
        raycast.cast_pixel(number, rows, first_thing, scenery, pictures)


@cuda.jit
def _develop(rows: Any, grain: Any, taken: Any, pictures: Any) -> None:  # noqa: ANN401
    number = cuda.grid(1)
    if number < pictures.size // pictures.shape[4]:
        raycast.develop_pixel(number, rows, grain, taken, pictures)
