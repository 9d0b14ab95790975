"""Plane maths on batched tensors, written so that an element's result never depends on its batch.

On the CPU torch gives the same bits for an element alone and in a batch for + - * / sqrt sin cos
tan and remainder, but not for atan2 and not for reductions; so only the former are used here.
Inputs should be contiguous.
"""

import math

import torch
from torch import Tensor


def wrap_angle(angle: Tensor) -> Tensor:
    """Return the angle [rad] wrapped to [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def rotate(x: Tensor, y: Tensor, cos: Tensor, sin: Tensor) -> tuple[Tensor, Tensor]:
    """Rotate a vector by the angle with this cosine and sine (body to world for a car's yaw)."""
    return cos * x - sin * y, sin * x + cos * y


def unrotate(x: Tensor, y: Tensor, cos: Tensor, sin: Tensor) -> tuple[Tensor, Tensor]:
    """Rotate a vector back (world to body for a car's yaw)."""
    return cos * x + sin * y, cos * y - sin * x


def heading_of(x: Tensor, y: Tensor) -> Tensor:
    """Return the direction of a vector [rad] in (-pi, pi]; batch-invariant, unlike torch.atan2."""
    # tan(a/2) = y / (r + x) is stable for x >= 0; for x < 0 use (r - x) / y.
    r = torch.sqrt(x * x + y * y)
    forward = 2 * torch.atan(y / torch.clamp(r + x, min=1e-30))
    sign = torch.where(y < 0, -torch.ones_like(y), torch.ones_like(y))
    backward = sign * math.pi - 2 * torch.atan(y / torch.clamp(r - x, min=1e-30))
    return torch.where(x >= 0, forward, backward)
