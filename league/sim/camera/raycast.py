"""The same pictures by casting a ray for each pixel: scalar code that a GPU can run, too.

It shares shapes, textures and colours with the painter but none of its projection, clipping or
painting, so that each can be held against the other. All numbers are float32, which GPUs do fast.
"""

from typing import NamedTuple

import numpy as np

from league.jit import inner
from league.portable_math import clamp, f32, sincos
from league.sim.camera import tables
from league.sim.camera.renderer import Renderer, models
from league.sim.camera.scene import (
    FLAT_RUBBER,
    MODELS,
    PAINTS,
    RUBBER,
    SUN,
    WALL_HEIGHT,
    far_from,
    luma,
)
from league.sim.camera.scene_state import NEAR
from league.sim.camera.tables import THING_COLUMNS, Pose
from league.sim.camera.visual_randomization import NOISE_STEP, Look

LOOK = 1 + len(Pose._fields)
"""Column of a description where a Look begins: gains of the channels, leak, noise and place; track
and pose come before it, what stands around after it."""

_ZERO, _HALF, _ONE, _TOP = f32(0.0), f32(0.5), f32(1.0), f32(255.0)
_NEAR = f32(NEAR)
_FAR = f32(1e9)
_PARALLEL = f32(1e-12)
_HEIGHT = f32(WALL_HEIGHT)
_UP = f32(SUN[2])
_GRAY, _NOISE_STEP = f32(128.0), f32(NOISE_STEP)
_SKY = 4  # row of the colours of a room; walls are those at y_min, x_max, y_max, x_min
_FLOOR = 5


class Scenery(NamedTuple):
    """All that one camera can see on the tracks, as arrays that compiled code reads."""

    # focal length [px], column and row of the optical axis [px], distance at which cars are far [m]
    lens: np.ndarray
    eyes: np.ndarray  # (num_eyes,): how far each sits to the left of the middle [m]
    planes: np.ndarray  # (num_faces, 4): outward normal and offset, in the frame of the solid
    paints: np.ndarray  # (num_faces,) int32: row of `colours`, or -1 for the thing's own
    solids: np.ndarray  # (num_solids, 3) int32: first face, one past the last, and 1 if steered
    pivots: np.ndarray  # (num_solids, 2): where a steered solid turns [m]
    # (num_models, 3) int32: first solid, one past the last, and what it becomes when it is far
    models: np.ndarray
    radii: np.ndarray  # (num_models,): of a circle round the footprint [m]
    colours: np.ndarray  # (num_paints, 6): what a paint shows in the shade, and what full sun adds
    texels: np.ndarray  # uint8: of all floors; see Texture
    # (num_tracks, num_levels, 3) int64: first byte of a texture, its columns and rows
    textures: np.ndarray
    corners: np.ndarray  # (num_tracks, num_levels, 3): corner and size of a texel [m]
    levels: np.ndarray  # (num_tracks, height) int32: which texture a row of the picture reads
    rooms: np.ndarray  # (num_tracks, 4): x_min, y_min, x_max, y_max [m]
    walls: np.ndarray  # (num_tracks, 5, 3): colours of the four walls and of the sky


class Describer(Renderer):
    """Hands out what a camera sees as a row of numbers for each world, from which rays are cast."""

    def _draw(
        self, tracks: np.ndarray, poses: np.ndarray, things: np.ndarray, look: Look | None
    ) -> np.ndarray:
        """Return a description of each world; float32 (num_rows, 1, 1, size)."""
        size = things.shape[1] * things.shape[2]
        columns = [tracks[:, None], poses]
        if look is not None:
            columns += [look.gain, look.leak[:, None], look.noise[:, None], look.place[:, None]]
        rows = np.concatenate(
            [*columns, things.reshape(len(things), size)], axis=1, dtype=np.float32
        )
        return rows[:, None, None]

    @property
    def randomises(self) -> bool:
        """Whether a description has a Look."""
        return self._looks is not None

    @property
    def channels(self) -> int:
        """Numbers of a pixel: 1 in gray, 3 in colour."""
        return 3 if self._camera.colour else 1

    @property
    def first_thing(self) -> int:
        """Column of a description where the first thing begins; see THING_COLUMNS."""
        return LOOK + (self.channels + 3 if self.randomises else 0)

    def scenery(self) -> Scenery:
        """Return the tables that go with the descriptions."""
        lens, gray = self._lens, not self._camera.colour
        solids = [solid for model in MODELS for solid in model.solids]
        first_face = np.cumsum([0, *(len(solid.faces) for solid in solids)])
        paints = [
            FLAT_RUBBER if solid.rounded and PAINTS[paint] == RUBBER else paint
            for solid in solids
            for paint in solid.paints
        ]
        shapes = models(gray)
        sky = (luma(self._sky),) * 3 if gray else self._sky
        floors = [self._floor(track) for track in range(len(self._tracks.tracks))]
        pictures = [texels for floor in floors for texels in floor.texels]
        starts = np.cumsum([0, *map(len, pictures)])[:-1].reshape(len(floors), -1)
        columns = np.array([floor.levels[:, 0] for floor in floors], np.int64)
        bytes_of_texel = 1 if gray else 4
        sizes = np.array([len(texels) // bytes_of_texel for texels in pictures])
        lines = sizes.reshape(columns.shape) // columns
        levels = np.zeros((len(floors), lens.height), np.int32)
        for row, floor in zip(levels, floors, strict=True):
            for start, stop, level in floor.bands.tolist():
                row[start:stop] = level
        parts: dict[str, object] = {
            "lens": (lens.focal, lens.cx, lens.cy, far_from(lens.focal)),
            "eyes": lens.eyes,
            "planes": np.concatenate([solid.planes for solid in solids]),
            "pivots": shapes.pivots,
            "radii": np.hypot(*shapes.sizes.T),
            "colours": shapes.paints,
            "corners": [floor.levels[:, 1:] for floor in floors],
            "rooms": self._tracks.rooms,
            "walls": [[*floor.room.colours, sky] for floor in floors],
        }
        steered = [int(solid.pivot is not None) for solid in solids]
        return Scenery(
            **{name: np.ascontiguousarray(part, np.float32) for name, part in parts.items()},
            paints=np.array(paints, np.int32),
            solids=np.stack([first_face[:-1], first_face[1:], steered], axis=1).astype(np.int32),
            models=shapes.models.astype(np.int32),
            texels=np.concatenate(pictures),
            textures=np.stack([starts, columns, lines], axis=2),
            levels=levels,
        )


@inner
def cast_pixel(number, rows, first_thing, scenery, pictures):
    """Write one pixel of pictures, before they are developed; pixels count from 0.

    Args:
        number: of the pixel, in the order of the array.
        rows: descriptions, (num_rows, size).
        first_thing: see Describer.first_thing.
        scenery: what the camera can see on the tracks.
        pictures: uint8 (num_rows, num_eyes, height, width, channels).
    """
    n, eye, line, column = _place(number, pictures)
    colour = _colour(rows[n], first_thing, scenery, eye, line, column, pictures.shape[4])
    for k in range(pictures.shape[4]):
        pictures[n, eye, line, column, k] = _byte(colour[k])


@inner
def develop_pixel(number, rows, grain, pictures, developed):
    """Write one pixel with its leak from the neighbours, its light and its noise.

    Arguments are those of cast_pixel, and `grain` is that of visual_randomization.
    """
    n, eye, line, column = _place(number, pictures)
    picture, channels = pictures[n, eye], pictures.shape[4]
    above, below = max(line - 1, 0), min(line + 1, len(picture) - 1)
    before, after = max(column - 1, 0), min(column + 1, picture.shape[1] - 1)
    look = rows[n, LOOK:]
    leak, strength, place = look[channels], look[channels + 1], look[channels + 2]
    noise = int(place) + (number % (picture.size * pictures.shape[1] // channels)) * channels
    for k in range(channels):
        light = _ZERO
        for row, share in ((above, leak), (line, _ONE - leak - leak), (below, leak)):
            sides = f32(picture[row, before, k]) + f32(picture[row, after, k])
            middle = (_ONE - leak - leak) * f32(picture[row, column, k])
            light += share * (leak * sides + middle)
        light = clamp(light * look[k], _ZERO, _TOP)
        sample = (f32(grain[noise + k]) - _GRAY) / _NOISE_STEP
        developed[n, eye, line, column, k] = _byte(light + strength * sample)


@inner
def _place(number, pictures):
    """Return row, eye, line and column of a pixel."""
    width, height = pictures.shape[3], pictures.shape[2]
    column, rest = number % width, number // width
    line, rest = rest % height, rest // height
    return rest // pictures.shape[1], rest % pictures.shape[1], line, column


@inner
def _byte(value):
    """Return the nearest whole number from 0 to 255."""
    return np.uint8(clamp(value + _HALF, _ZERO, _TOP))


@inner
def _colour(row, first_thing, scenery, eye, line, column, channels):
    """Return the colour of a pixel, three float32 of which the first counts in gray."""
    ray = _ray(row, scenery, eye, line, column)
    track = int(row[0])
    depth, surface = _room(ray, scenery.rooms[track])
    seen, turn = -1, (_ONE, _ZERO)
    for start in range(first_thing, len(row), THING_COLUMNS):
        thing = row[start : start + THING_COLUMNS]
        depth, face, steering = _thing(row, thing, ray, scenery, depth)
        if face >= 0:
            seen, surface, turn = start, face, steering
    if seen >= 0:
        return _shade(row[seen : seen + THING_COLUMNS], scenery, surface, turn)
    if surface == _FLOOR:
        x, y, _, dx, dy, _ = ray
        place = x + depth * dx, y + depth * dy
        return _sample(scenery, track, scenery.levels[track, line], place, channels)
    wall = scenery.walls[track, surface]
    return wall[0], wall[1], wall[2]


@inner
def _ray(row, scenery, eye, line, column):
    """Return where a pixel looks from and to, x, y and z in the world frame [m].

    The way to is as long as the depth grows by 1.
    """
    x, y, z, cos, sin, pitch_cos, pitch_sin = row[1], row[2], row[3], row[4], row[5], row[6], row[7]
    roll_cos, roll_sin = row[8], row[9]
    focal, shift = scenery.lens[0], scenery.eyes[eye]
    right = (f32(column) - scenery.lens[1]) / focal
    below = (f32(line) - scenery.lens[2]) / focal
    # To the right and down in the picture of a camera that does not roll.
    across, down = right * roll_cos - below * roll_sin, right * roll_sin + below * roll_cos
    eye_ahead, eye_left = shift * roll_sin * pitch_sin, shift * roll_cos
    ahead, up = pitch_cos - down * pitch_sin, -pitch_sin - down * pitch_cos
    return (
        x + cos * eye_ahead - sin * eye_left,
        y + sin * eye_ahead + cos * eye_left,
        z + shift * roll_sin * pitch_cos,
        cos * ahead + sin * across,
        sin * ahead - cos * across,
        up,
    )


@inner
def _room(ray, room):
    """Return the depth at which a ray leaves an empty room, and through what."""
    x, y, z, dx, dy, dz = ray
    to_x, to_y, to_floor = _FAR, _FAR, _FAR
    if dx != _ZERO:
        to_x = ((room[2] if dx > _ZERO else room[0]) - x) / dx
    if dy != _ZERO:
        to_y = ((room[3] if dy > _ZERO else room[1]) - y) / dy
    if dz < _ZERO:
        to_floor = -z / dz
    to_wall = min(to_x, to_y)
    if to_floor <= to_wall:
        return to_floor, _FLOOR
    if z + to_wall * dz > _HEIGHT:
        return _FAR, _SKY
    if to_x < to_y:
        return to_wall, 1 if dx > _ZERO else 3
    return to_wall, 2 if dy > _ZERO else 0


@inner
def _sample(scenery, track, level, place, channels):
    """Return the floor's colour at a place in the world, bilinear."""
    texture = scenery.textures[track, level]
    first, columns, lines = texture[0], texture[1], texture[2]
    corner = scenery.corners[track, level]
    x = clamp((place[0] - corner[0]) / corner[2] - _HALF, _ZERO, f32(columns - 1))
    y = clamp((place[1] - corner[1]) / corner[2] - _HALF, _ZERO, f32(lines - 1))
    left, low = min(int(x), columns - 2), min(int(y), lines - 2)
    part, rise = x - f32(left), y - f32(low)
    step = 1 if channels == 1 else 4
    at = first + (low * columns + left) * step
    red = _blend(scenery.texels, at, step, columns * step, part, rise)
    if channels == 1:
        return red, red, red
    green = _blend(scenery.texels, at + 1, step, columns * step, part, rise)
    return red, green, _blend(scenery.texels, at + 2, step, columns * step, part, rise)


@inner
def _blend(texels, at, aside, above, part, rise):
    """Return the mean of four texels by the place between them."""
    low = f32(texels[at]) * (_ONE - part) + f32(texels[at + aside]) * part
    high = f32(texels[at + above]) * (_ONE - part) + f32(texels[at + above + aside]) * part
    return low * (_ONE - rise) + high * rise


@inner
def _thing(row, thing, ray, scenery, depth):
    """Return the depth at which a ray meets a thing, the face, and cosine and sine of its steering.

    The face is -1 where something else is nearer.
    """
    face, steering = -1, (_ONE, _ZERO)
    model = scenery.models[int(thing[tables.MODEL])]
    away_x, away_y = thing[tables.X] - row[1], thing[tables.Y] - row[2]
    if away_x * away_x + away_y * away_y > scenery.lens[3] * scenery.lens[3]:
        model = scenery.models[model[2]]
    x, y, z, dx, dy, dz = ray
    along, across, upward = thing[tables.ALONG], thing[tables.ACROSS], thing[tables.UPWARD]
    radius = scenery.radii[int(thing[tables.MODEL])] * max(along, across)
    off_x, off_y = x - thing[tables.X], y - thing[tables.Y]
    miss = off_x * dy - off_y * dx
    if miss * miss > radius * radius * (dx * dx + dy * dy):
        return depth, face, steering
    cos, sin = thing[tables.COS], thing[tables.SIN]
    off_x, off_y, z, dx, dy, dz = _turned((off_x, off_y, z, dx, dy, dz), cos, sin)
    off_x, off_y, z = off_x / along, off_y / across, z / upward
    dx, dy, dz = dx / along, dy / across, dz / upward
    turn_sin, turn_cos = sincos(thing[tables.STEERING])
    for s in range(model[0], model[1]):
        solid = scenery.solids[s]
        local, turn = (off_x, off_y, z, dx, dy, dz), (_ONE, _ZERO)
        if solid[2]:
            from_x, from_y = off_x - scenery.pivots[s, 0], off_y - scenery.pivots[s, 1]
            turn = turn_cos, turn_sin
            from_x, from_y = (
                turn_cos * from_x + turn_sin * from_y,
                turn_cos * from_y - turn_sin * from_x,
            )
            ahead, left = turn_cos * dx + turn_sin * dy, turn_cos * dy - turn_sin * dx
            local = from_x, from_y, z, ahead, left, dz
        enter, entered = _enter(local, scenery.planes, solid[0], solid[1])
        if _NEAR <= enter < depth:
            depth, face, steering = enter, entered, turn
    return depth, face, steering


@inner
def _turned(ray, cos, sin):
    """Return a ray in a frame that is turned to the left."""
    x, y, z, dx, dy, dz = ray
    return cos * x + sin * y, cos * y - sin * x, z, cos * dx + sin * dy, cos * dy - sin * dx, dz


@inner
def _enter(ray, planes, first, stop):
    """Return where a ray enters a convex solid (far away: nowhere), and through which face."""
    x, y, z, dx, dy, dz = ray
    enter, leave, face = -_FAR, _FAR, first
    for number in range(first, stop):
        plane = planes[number]
        along = plane[0] * dx + plane[1] * dy + plane[2] * dz
        # A ray along the face is as good as one that meets it far away.
        if abs(along) < _PARALLEL:
            along = _PARALLEL
        at = (plane[3] - (plane[0] * x + plane[1] * y + plane[2] * z)) / along
        if along > _ZERO:
            leave = min(leave, at)
        elif at > enter:
            enter, face = at, number
    return (enter if enter < leave else _FAR), face


@inner
def _shade(thing, scenery, face, steering):
    """Return the colour of a thing's face in the sun."""
    cos, sin = thing[tables.COS], thing[tables.SIN]
    sun_x, sun_y = f32(SUN[0]), f32(SUN[1])
    sun_x, sun_y = cos * sun_x + sin * sun_y, cos * sun_y - sin * sun_x
    turn_cos, turn_sin = steering
    sun_x, sun_y = turn_cos * sun_x + turn_sin * sun_y, turn_cos * sun_y - turn_sin * sun_x
    plane = scenery.planes[face]
    facing = max(plane[0] * sun_x + plane[1] * sun_y + plane[2] * _UP, _ZERO)
    paint = scenery.paints[face]
    colour = thing[tables.SHADE :] if paint < 0 else scenery.colours[paint]
    return (
        colour[0] + facing * colour[3],
        colour[1] + facing * colour[4],
        colour[2] + facing * colour[5],
    )
