"""Plane maths: hand-worked values, and that an element's result never depends on its batch."""

import math

import pytest
import torch

from league import geometry


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (0.0, 0.0),
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (3.5, 3.5 - 2 * math.pi),
        (7.0, 0.7168),
    ],
)
def test_angles_are_wrapped_to_half_a_turn_either_way(angle, wrapped):
    assert float(geometry.wrap_angle(torch.tensor([angle]))) == pytest.approx(wrapped, abs=1e-4)


def test_rotating_by_a_quarter_turn_sends_ahead_to_left():
    x, y = geometry.rotate(
        torch.tensor(1.0), torch.tensor(0.0), torch.tensor(0.0), torch.tensor(1.0)
    )
    assert (float(x), float(y)) == (0.0, 1.0)


def test_rotating_back_undoes_a_rotation():
    angle = torch.linspace(-3, 3, 13)
    x, y = torch.linspace(-2, 5, 13), torch.linspace(4, -1, 13)
    there = geometry.rotate(x, y, torch.cos(angle), torch.sin(angle))
    back = geometry.unrotate(*there, torch.cos(angle), torch.sin(angle))
    assert torch.allclose(back[0], x, atol=1e-6)
    assert torch.allclose(back[1], y, atol=1e-6)


def test_heading_agrees_with_atan2_all_round():
    angle = torch.linspace(-math.pi, math.pi, 1001, dtype=torch.float64)[1:]
    length = torch.logspace(-3, 3, 1000, dtype=torch.float64)
    x, y = (length * torch.cos(angle)).float(), (length * torch.sin(angle)).float()
    wanted = torch.tensor([math.atan2(b, a) for a, b in zip(x.tolist(), y.tolist(), strict=True)])
    assert float(geometry.wrap_angle(geometry.heading_of(x, y) - wanted).abs().max()) < 1e-6


@pytest.mark.parametrize(
    ("x", "y", "heading"),
    [(1, 0, 0), (0, 1, math.pi / 2), (-1, 0, math.pi), (0, -1, -math.pi / 2), (0, 0, 0)],
)
def test_heading_along_the_axes_is_exact(x, y, heading):
    told = geometry.heading_of(torch.tensor([float(x)]), torch.tensor([float(y)]))
    assert float(told) == pytest.approx(heading, abs=1e-7)


def test_an_element_has_the_same_bits_alone_and_in_a_batch():
    x, y = torch.randn(4097, generator=torch.Generator().manual_seed(1)), torch.randn(4097)
    together = geometry.wrap_angle(3 * geometry.heading_of(x, y))
    for place in (0, 1, 7, 2048, 4096):
        alone = geometry.wrap_angle(
            3 * geometry.heading_of(x[place : place + 1].clone(), y[place : place + 1].clone())
        )
        assert torch.equal(alone, together[place : place + 1])
