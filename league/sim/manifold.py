"""Where two oriented boxes touch, or would: separating axes and edge clipping, batched over pairs.

After E. Catto's Box2D-Lite: the face that separates the boxes best is the reference, the other
box's face that looks at it most is clipped to its width, and the clipped edge's two ends are the
contact points. Points exist before the boxes touch, so a solver can look one step ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from league.geometry import rotate, unrotate


@dataclass(frozen=True)
class Pose:
    """Where boxes are, and their sizes."""

    x: Tensor
    """Centre, world frame [m]."""
    y: Tensor
    """Centre, world frame [m]."""
    cos: Tensor
    """Cosine of the heading."""
    sin: Tensor
    """Sine of the heading."""
    half_length: Tensor
    """[m]."""
    half_width: Tensor
    """[m]."""


@dataclass(frozen=True)
class Manifold:
    """Where the boxes of each pair touch, or would."""

    normal_x: Tensor
    """Unit vector from the first box to the second, world frame."""
    normal_y: Tensor
    """Unit vector from the first box to the second, world frame."""
    gap: Tensor
    """Distance between the boxes along the normal at each point [m], negative in overlap."""
    exists: Tensor
    """Whether the faces lie opposite each other at all, bool, (num_pairs,)."""
    first_x: Tensor
    """Points relative to the first box's centre, world frame [m]."""
    first_y: Tensor
    """Points relative to the first box's centre, world frame [m]."""
    second_x: Tensor
    """Points relative to the second box's centre, world frame [m]."""
    second_y: Tensor
    """Points relative to the second box's centre, world frame [m]."""


def find_manifold(a: Pose, b: Pose) -> Manifold:
    """Return where the boxes of each pair touch, by separating axes and edge clipping."""
    dx, dy = b.x - a.x, b.y - a.y
    a_x, a_y = unrotate(dx, dy, a.cos, a.sin)
    b_x, b_y = unrotate(dx, dy, b.cos, b.sin)
    cos = a.cos * b.cos + a.sin * b.sin
    sin = a.cos * b.sin - a.sin * b.cos
    c, s = cos.abs(), sin.abs()
    a_length = a_x.abs() - a.half_length - (b.half_length * c + b.half_width * s)
    a_width = a_y.abs() - a.half_width - (b.half_length * s + b.half_width * c)
    b_length = b_x.abs() - b.half_length - (a.half_length * c + a.half_width * s)
    b_width = b_y.abs() - b.half_width - (a.half_length * s + a.half_width * c)
    # The box with the face that separates best is the reference; its face's normal is the normal.
    flip = torch.maximum(b_length, b_width) > torch.maximum(a_length, a_width)
    from_a = (a_x, a_y, sin, a.cos, a.sin, a_length, a_width)
    from_b = (-b_x, -b_y, -sin, b.cos, b.sin, b_length, b_width)
    sizes_a, sizes_b = (a.half_length, a.half_width), (b.half_length, b.half_width)
    x, y, sin, ref_cos, ref_sin, by_length, by_width, length, width, i_length, i_width = (
        torch.where(
            flip,
            torch.stack((*from_b, *sizes_b, *sizes_a)),
            torch.stack((*from_a, *sizes_a, *sizes_b)),
        ).unbind()
    )
    # Face frame of the reference: n outward, t = n turned left.
    ahead = by_length > by_width
    one = torch.ones_like(x)
    n_x = torch.where(ahead, torch.copysign(one, x), 0.0)
    n_y = torch.where(ahead, 0.0, torch.copysign(one, y))
    half_n, half_t = torch.where(ahead, length, width), torch.where(ahead, width, length)
    # Incident box's length axis u in that frame, and its face that looks at the reference most.
    u_n, u_t = n_x * cos + n_y * sin, n_x * sin - n_y * cos
    ends = u_n.abs() > u_t.abs()
    f_n, f_t = torch.where(ends, u_n, -u_t), torch.where(ends, u_t, u_n)
    deep, half = torch.where(ends, i_length, i_width), torch.where(ends, i_width, i_length)
    deep = torch.copysign(deep, f_n)
    edge_n = torch.where(ahead, x.abs(), y.abs()) - deep * f_n
    edge_t = n_x * y - n_y * x - deep * f_t
    # The edge is (edge_n, edge_t) + q (run_n, run_t), run_t > 0; clip it to the face.
    run_t = f_n.abs()
    run_n = -f_t * torch.copysign(one, f_n)
    low = torch.maximum(-half, (-half_t - edge_t) / run_t)
    high = torch.minimum(half, (half_t - edge_t) / run_t)
    q = torch.stack((low, high))
    gap = edge_n + q * run_n - half_n
    # Contact points lie midway between face and edge.
    p_n, p_t = half_n + gap * 0.5, edge_t + q * run_t
    p_x, p_y = rotate(n_x * p_n - n_y * p_t, n_y * p_n + n_x * p_t, ref_cos, ref_sin)
    first_x, first_y = p_x + torch.where(flip, dx, 0.0), p_y + torch.where(flip, dy, 0.0)
    normal_x, normal_y = rotate(n_x, n_y, ref_cos, ref_sin)
    return Manifold(
        normal_x=torch.where(flip, -normal_x, normal_x),
        normal_y=torch.where(flip, -normal_y, normal_y),
        gap=gap,
        exists=low <= high,
        first_x=first_x,
        first_y=first_y,
        second_x=first_x - dx,
        second_y=first_y - dy,
    )
