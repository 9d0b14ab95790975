"""RayRenderer: the same pictures by casting a ray for each pixel, in torch.

It shares the shapes, textures and colours with what is painted but none of its projection,
clipping or painting, so that each can be held against the other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from league.sim.camera import scene, tables, visual_randomization
from league.sim.camera.renderer import Renderer
from league.sim.camera.scene_state import NEAR, SceneState, mount_of
from league.sim.camera.tables import Floor
from league.sim.camera.visual_randomization import Look

_FAR = 1e9
# A processor's cache holds what is worked out for so many; 16 times as many take 3 times as long.
_PIXELS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class _Rays:
    """Where each pixel looks from and to, in the frame of the camera's yaw; z [m] is up.

    Ways are as long as the depth grows by 1.
    """

    x: Tensor
    y: Tensor
    z: Tensor
    ahead: Tensor
    left: Tensor
    up: Tensor

    def turned(self, x: Tensor, y: Tensor, cos: Tensor, sin: Tensor) -> "_Rays":
        """Return the rays in the frame of a body at x, y with this heading; (num_rows,) each."""
        x, y, cos, sin = (value.reshape(-1, 1, 1, 1) for value in (x, y, cos, sin))
        dx, dy = self.x - x, self.y - y
        return _Rays(
            cos * dx + sin * dy,
            cos * dy - sin * dx,
            self.z,
            cos * self.ahead + sin * self.left,
            cos * self.left - sin * self.ahead,
            self.up,
        )

    def stretched(self, along: Tensor, across: Tensor, upward: Tensor) -> "_Rays":
        """Return the rays in the frame of a body that was stretched this much; (num_rows,) each."""
        along, across, upward = (value.reshape(-1, 1, 1, 1) for value in (along, across, upward))
        x, y, z = self.x / along, self.y / across, self.z / upward
        return _Rays(x, y, z, self.ahead / along, self.left / across, self.up / upward)


@dataclass(frozen=True)
class _Body:
    """One car or box in each world, in the frame of the camera's yaw; (num_rows,) each."""

    model: scene.Model
    pose: tuple[Tensor, Tensor, Tensor, Tensor]  # x, y [m], cosine and sine of the yaw
    sun: tuple[Tensor, Tensor]  # the sun's direction in the body's own frame
    steering: tuple[Tensor, Tensor]  # cosine and sine
    scale: tuple[Tensor, Tensor, Tensor]  # stretch of the model ahead, to the side and upwards
    colour: Tensor  # (num_rows, 3)


class RayRenderer(Renderer):
    """Casts the rays of many worlds at once."""

    def __init__(self, *arguments: Any) -> None:
        """See Renderer."""
        super().__init__(*arguments)
        self._textures: dict[int, list[Tensor]] = {}

    def _draw(self, state: SceneState, car: int, look: Look | None) -> np.ndarray:
        cfg = self._camera
        pixels = cfg.num_eyes * cfg.height * cfg.width
        size = max(1, _PIXELS_AT_ONCE // pixels)
        shape = (len(state.track), *cfg.shape)
        pictures = torch.zeros(shape, dtype=torch.uint8)
        poses, things = state.tables(car, mount_of(cfg))
        for start in range(0, len(state.track), size):
            part = slice(start, min(start + size, len(state.track)))
            tracks = state.track[part].tolist()
            views = self._tensor(poses[part])
            pictures[part] = self._render(tracks, views, things[part], look, part)
        return pictures.numpy()

    def _render(
        self, tracks: list[int], poses: Tensor, things: np.ndarray, look: Look | None, part: slice
    ) -> Tensor:
        """Return the pictures of a part of the rows, from its tracks and tables."""
        rays = self._rays(poses)
        depth, pictures = self._room(tracks, poses, rays)
        for slot in range(things.shape[1]):
            body = self._body(poses, things[:, slot])
            x, y = body.pose[:2]
            is_far = torch.sqrt(x * x + y * y) > scene.far_from(self._lens.focal)
            shown = [(body, torch.ones_like(is_far))]
            if body.model is scene.CAR:
                shown = [(body, ~is_far), (replace(body, model=scene.FAR_CAR), is_far)]
            for seen, mask in shown:
                depth, pictures = self._meet(rays, seen, mask, depth, pictures)
        if look is not None:
            pictures = self._developed(pictures, look, part)
        # (rows, eyes, height, width, channels) -> (rows, eyes * channels, height, width)
        pictures = pictures.permute(0, 1, 4, 2, 3).reshape(-1, *self._camera.shape)
        return torch.clamp(torch.floor(pictures + 0.5), 0, 255).to(torch.uint8)

    def _tensor(self, values: Sequence[Any] | np.ndarray) -> Tensor:
        return torch.tensor(values, dtype=torch.float32)

    def _developed(self, pictures: Tensor, look: Look, part: slice) -> Tensor:
        """Return float pictures, (num_rows, num_eyes, height, width, channels), with their look."""
        leak = self._tensor(look.leak[part]).reshape(-1, 1, 1, 1, 1)
        for axis in (2, 3):
            size = pictures.shape[axis]
            rows_before = torch.arange(-1, size - 1).clamp(min=0)
            rows_after = torch.arange(1, size + 1).clamp(max=size - 1)
            before = pictures.index_select(axis, rows_before)
            after = pictures.index_select(axis, rows_after)
            pictures = pictures + leak * (before + after - 2 * pictures)
        gain = self._tensor(look.gain[part])[:, None, None, None, :]
        pictures = torch.clamp(pictures * gain, 0, 255)
        size = pictures[0].numel()
        grain = torch.from_numpy(visual_randomization.grain(size))
        places = torch.from_numpy(look.place[part, None] + np.arange(size))
        noise = grain[places].reshape(pictures.shape).to(pictures.dtype) - 128
        sigma = self._tensor(look.noise[part] / visual_randomization.NOISE_STEP)
        return pictures + noise * sigma.reshape(-1, 1, 1, 1, 1)

    # The room ------------------------------------------------------------------------------

    def _rays(self, poses: Tensor) -> _Rays:
        lens = self._lens
        height, pitch_cos, pitch_sin, roll_cos, roll_sin = (
            poses[:, index].reshape(-1, 1, 1, 1) for index in (2, 5, 6, 7, 8)
        )
        column = (torch.arange(lens.width) - lens.cx) / lens.focal
        row = (torch.arange(lens.height) - lens.cy) / lens.focal
        row = row.reshape(1, 1, -1, 1)
        # To the right and down in the picture of a camera that does not roll.
        across, down = column * roll_cos - row * roll_sin, column * roll_sin + row * roll_cos
        eyes = self._tensor(lens.eyes).reshape(1, -1, 1, 1)
        shape = (len(poses), len(lens.eyes), lens.height, lens.width)
        parts = (
            eyes * roll_sin * pitch_sin,
            eyes * roll_cos,
            height + eyes * roll_sin * pitch_cos,
            pitch_cos - down * pitch_sin,
            -across,
            -pitch_sin - down * pitch_cos,
        )
        return _Rays(*(part.expand(shape) for part in parts))

    def _room(self, tracks: list[int], poses: Tensor, rays: _Rays) -> tuple[Tensor, Tensor]:
        """Return the depth and the picture of the empty room."""
        x, y, _, cos, sin = poses.unbind(1)[:5]
        # The world's origin in the frame of the camera's yaw.
        inside = rays.turned(-(cos * x + sin * y), sin * x - cos * y, cos, -sin)
        index = torch.tensor(tracks)
        x_min, y_min, x_max, y_max = (
            part.reshape(-1, 1, 1, 1) for part in self._tensor(self._tracks.rooms)[index].unbind(1)
        )
        far = torch.full_like(inside.x, _FAR)
        to_x = torch.where(inside.ahead > 0, x_max - inside.x, x_min - inside.x) / inside.ahead
        to_y = torch.where(inside.left > 0, y_max - inside.y, y_min - inside.y) / inside.left
        to_x = torch.where(inside.ahead == 0, far, to_x)
        to_y = torch.where(inside.left == 0, far, to_y)
        to_wall = torch.minimum(to_x, to_y)
        to_floor = torch.where(rays.up < 0, -rays.z / rays.up, far)
        is_floor = to_floor <= to_wall
        is_wall = ~is_floor & (rays.z + to_wall * rays.up <= scene.WALL_HEIGHT)
        depth = torch.where(is_floor, to_floor, torch.where(is_wall, to_wall, far))
        floor_x, floor_y = inside.x + depth * inside.ahead, inside.y + depth * inside.left
        # Walls are listed as y_min, x_max, y_max, x_min; 4 is the sky.
        on_x = torch.where(inside.ahead > 0, 1, 3)
        side = torch.where(to_x < to_y, on_x, torch.where(inside.left > 0, 2, 0))
        side = torch.where(is_wall, side, 4)
        channels = 3 if self._camera.colour else 1
        sky = scene.SKY_COLOUR if self._camera.colour else (scene.luma(scene.SKY_COLOUR),)
        pictures = torch.empty((*far.shape, channels))
        for track in sorted(set(tracks)):
            here = (index == track).nonzero()[:, 0]
            floor, textures = self._floor(track), self._textures_of(track)
            backs = self._tensor(floor.room.colours)[:, :channels]
            backs = torch.cat([backs, self._tensor([sky])])
            ground = self._sample(floor, textures, floor_x[here], floor_y[here])
            on_floor = is_floor[here].unsqueeze(-1)
            pictures[here] = torch.where(on_floor, ground, backs[side[here]])
        return depth, pictures

    def _textures_of(self, track: int) -> list[Tensor]:
        """Return the levels of a track's floor, finest first, each (num_texels, channels)."""
        if track not in self._textures:
            channels = 3 if self._camera.colour else 1
            self._textures[track] = [
                # Of a texel in colour the first byte is red, and the last one empty.
                torch.from_numpy(texels).reshape(-1, 4 if channels == 3 else 1)[:, :channels]
                for texels in self._floor(track).texels
            ]
        return self._textures[track]

    def _sample(self, floor: Floor, textures: list[Tensor], x: Tensor, y: Tensor) -> Tensor:
        """Return the floor's colour at places in the world, bilinear; (..., channels)."""
        colours = []
        for start, stop, number in floor.bands.tolist():
            texture = textures[number]
            columns, origin_x, origin_y, size = floor.levels[number].tolist()
            width = int(columns)
            height = len(texture) // width
            column = (x[:, :, start:stop] - origin_x) / size - 0.5
            line = (y[:, :, start:stop] - origin_y) / size - 0.5
            column = torch.clamp(column, 0, width - 1)
            line = torch.clamp(line, 0, height - 1)
            left = torch.clamp(column.to(torch.int64), max=width - 2)
            low = torch.clamp(line.to(torch.int64), max=height - 2)
            part, rise = (column - left).unsqueeze(-1), (line - low).unsqueeze(-1)
            corner = low * width + left
            below = texture[corner] * (1 - part) + texture[corner + 1] * part
            above = texture[corner + width] * (1 - part) + texture[corner + width + 1] * part
            colours.append(below * (1 - rise) + above * rise)
        return torch.cat(colours, dim=2)

    # Things --------------------------------------------------------------------------------

    def _body(self, poses: Tensor, things: np.ndarray) -> _Body:
        """Return what stands in one slot of each world, as tensors; (num_rows, THING_COLUMNS)."""
        x, y, _, cos, sin = poses.unbind(1)[:5]
        columns = self._tensor(things).unbind(1)
        dx, dy = columns[tables.X] - x, columns[tables.Y] - y
        body_cos, body_sin, steering = columns[tables.COS : tables.STEERING + 1]
        turn = (body_cos * cos + body_sin * sin, body_sin * cos - body_cos * sin)
        sun_x, sun_y, _ = scene.SUN
        return _Body(
            model=scene.MODELS[int(things[0, tables.MODEL])],
            pose=(cos * dx + sin * dy, cos * dy - sin * dx, *turn),
            sun=(sun_x * body_cos + sun_y * body_sin, sun_y * body_cos - sun_x * body_sin),
            steering=(torch.cos(steering), torch.sin(steering)),
            scale=(columns[tables.ALONG], columns[tables.ACROSS], columns[tables.UPWARD]),
            colour=torch.stack(columns[tables.SHADE : tables.SUNLIT], dim=1),
        )

    def _meet(
        self, rays: _Rays, body: _Body, mask: Tensor, depth: Tensor, pictures: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return depth and pictures with a body put in, in the rows of the mask."""
        if not bool(mask.any()):
            return depth, pictures
        local = rays.turned(*body.pose).stretched(*body.scale)
        for solid in body.model.solids:
            seen, (sun_x, sun_y) = local, body.sun
            if solid.pivot is not None:
                cos, sin = body.steering
                pivot = torch.tensor(solid.pivot).expand(len(cos), 2)
                seen = local.turned(pivot[:, 0], pivot[:, 1], cos, sin)
                sun_x, sun_y = cos * sun_x + sin * sun_y, cos * sun_y - sin * sun_x
            enter, face = _enter(seen, solid)
            hit = (enter >= NEAR) & (enter < depth) & mask.reshape(-1, 1, 1, 1)
            colours = self._colours(solid, body, sun_x, sun_y)  # (rows, faces, channels)
            row = torch.arange(len(colours)).reshape(-1, 1, 1, 1)
            depth = torch.where(hit, enter, depth)
            pictures = torch.where(hit.unsqueeze(-1), colours[row, face], pictures)
        return depth, pictures

    def _colours(self, solid: scene.Solid, body: _Body, sun_x: Tensor, sun_y: Tensor) -> Tensor:
        """Return the lit colour of each face in each world; (num_rows, num_faces, channels)."""
        colours = []
        for (nx, ny, nz, _), paint in zip(solid.planes.tolist(), solid.paints, strict=True):
            known = scene.PAINTS[paint] if paint >= 0 else None
            base = body.colour if known is None else self._tensor(known).expand_as(body.colour)
            if known != scene.RUBBER or not solid.rounded:
                facing = torch.clamp(nx * sun_x + ny * sun_y + nz * scene.SUN[2], min=0)
                sun = self._tensor(scene.DIFFUSE) * facing.unsqueeze(1)
                base = base * (scene.AMBIENT + sun)
            if not self._camera.colour:
                red, green, blue = base.unbind(1)
                parts = scene.LUMA
                base = (parts[0] * red + parts[1] * green + parts[2] * blue).unsqueeze(1)
            colours.append(base)
        return torch.stack(colours, dim=1)


def _enter(rays: _Rays, solid: scene.Solid) -> tuple[Tensor, Tensor]:
    """Return where each ray enters a convex solid (infinity: nowhere), and through which face."""
    enter = torch.full_like(rays.x, -_FAR)
    leave = torch.full_like(rays.x, _FAR)
    face = torch.zeros_like(rays.x, dtype=torch.int64)
    for number, (nx, ny, nz, offset) in enumerate(solid.planes.tolist()):
        along = nx * rays.ahead + ny * rays.left + nz * rays.up
        gap = offset - (nx * rays.x + ny * rays.y + nz * rays.z)
        # A ray along the face is as good as one that meets it far away.
        along = torch.where(along.abs() < 1e-12, torch.full_like(along, 1e-12), along)
        at = gap / along
        later = (along < 0) & (at > enter)
        enter = torch.where(later, at, enter)
        face = torch.where(later, number, face)
        leave = torch.where(along > 0, torch.minimum(leave, at), leave)
    return torch.where(enter < leave, enter, torch.full_like(enter, math.inf)), face
