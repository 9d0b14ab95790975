"""Compiled: whole pictures of many worlds, by the painters of floors and of things."""

from league.jit import compiled, inner, spliced
from league.sim.camera.floor_raster import draw_floor, draw_tilted_floor
from league.sim.camera.raster import draw_room
from league.sim.camera.tables import Pose, Texture

FLOOR, ROOM = 1, 2
"""Phases of a picture: the sky and the floor; the walls and what stands before them."""


@compiled(allocates=True)
def paint(phases, rows, pictures, poses, things, floor, sky, optics, far, models):
    """Draw the pictures of some worlds on one track.

    Args:
        phases: what to draw, FLOOR, ROOM or both.
        rows: the pictures to draw, int64 (num_rows,).
        pictures: uint8 (num_pictures, num_eyes, height, width * channels).
        poses: where each camera is, the fields of Pose, float64 (num_pictures, 9).
        things: what stands there, float64 (num_pictures, num_things, THING_COLUMNS).
        floor: the track's floor and walls.
        sky: a row of sky, uint8 (width * channels,).
        optics: the lens.
        far: things farther than this become what they are when far [m].
        models: the shapes.

    Returns:
        The row of the farthest floor in the last picture.
    """
    top = 0
    for n in rows:
        at = poses[n]
        view = Pose(at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8])
        if phases & FLOOR:
            top = _draw_ground(pictures[n], floor, sky, optics, view)
        if phases & ROOM:
            draw_room(pictures[n], optics, view, floor.room, things[n], far, models)
    return top


@spliced
def _draw_ground(pictures, floor, sky, optics, view):
    """Draw the sky and the floor of one picture; return the row of the farthest floor."""
    height = pictures.shape[1]
    level = view.roll_cos == 1 and view.roll_sin == 0
    top = _first_floor_row(height, floor.room, optics, view) if level else 0
    # Of a camera that rolls the horizon is a slope, and the sky lies next to the floor, too.
    for eye in range(len(pictures)):
        for row in range(top if level else height):
            out = pictures[eye, row]
            for k in range(len(sky)):
                out[k] = sky[k]
    for band in range(len(floor.bands)):
        start, stop = max(floor.bands[band, 0], top), floor.bands[band, 1]
        number = floor.bands[band, 2]
        fields = floor.levels[number]
        columns, size = int(fields[0]), fields[3]
        texture = Texture(floor.texels[number], columns, fields[1], fields[2], size)
        if start < stop and level:
            draw_floor(pictures, start, stop, texture, optics, view)
        elif start < stop:
            draw_tilted_floor(pictures, start, stop, texture, optics, view)
    return top


@inner
def _first_floor_row(height, room, optics, view):
    """Return the row of the farthest floor in view: no floor lies beyond the room's corners."""
    along_x = view.cos * ((room.x_max if view.cos > 0 else room.x_min) - view.x)
    farthest = along_x + view.sin * ((room.y_max if view.sin > 0 else room.y_min) - view.y)
    depth = farthest * view.pitch_cos + view.z * view.pitch_sin
    if depth <= optics.near:
        return 0
    rise = view.z * view.pitch_cos - farthest * view.pitch_sin
    row = optics.cy + optics.focal * rise / depth
    return int(min(max(row, 0.0), float(height)))
