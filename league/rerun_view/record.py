"""A replay as a Rerun recording: whole columns at once, on one timeline."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from league.atomic_file import replacing
from league.errors import ReplayError
from league.replay import Replay, story
from league.replay.replay import JUMP
from league.rerun_view import blueprint, paths, poses, shapes
from league.rerun_view.senses import EYE_CAMERA, send_eyes, send_lidar, times_of
from league.rerun_view.shapes import Mesh
from league.sim.camera.scene import BOT_COLOUR, BOX_COLOUR, CAR, CAR_COLOURS
from league.sim.config import ObstacleConfig
from league.track.track import Track

WALL_OPACITY = 0.3
SHADOW_OPACITY = 0.45
FROZEN_OPACITY = 0.35
NEUTRAL = (225, 230, 235)
TRAIL_LIFT = np.array([0.0, 0.0, 0.016])
"""How high a trail lies above the floor [m]."""
TAG_HEIGHT = 0.3
"""How high a car's name floats [m]."""
EVENT_LEVELS = {"crash": "ERROR", "off_track": "WARN", "contact": "WARN", "driver_fault": "ERROR"}


def build(
    replay: Replay,
    recording: rr.RecordingStream,
    *,
    cameras: bool = True,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Send a whole replay to a recording.

    Args:
        replay: what to show.
        recording: where to.
        cameras: also render and encode the cars' eyes, which takes most of the time.
        progress: told what is being done, a few words each.
    """
    told = progress or (lambda _: None)
    told("scene")
    send_scene(recording, replay.track, replay.names)
    send_obstacles(recording, replay)
    _send_motion(recording, replay)
    _send_charts(recording, replay)
    _send_events(recording, replay)
    recording.log(
        paths.TITLE,
        rr.TextDocument(classification(replay), media_type=rr.MediaType.MARKDOWN),
        static=True,
    )
    told("lidar")
    send_lidar(recording, replay)
    if cameras:
        told("cameras")
        send_eyes(recording, replay)


def save(
    replay: Replay,
    path: str | os.PathLike[str],
    *,
    cameras: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write a replay as a .rrd file, whole or not at all, and return its path."""
    recording = rr.RecordingStream(paths.APPLICATION, recording_id=_identity(replay))
    layout = blueprint.broadcast(replay.num_cars, replay.names, replay.track.room, cameras=cameras)
    with replacing(path, "the recording", ReplayError) as file:
        recording.save(file, default_blueprint=layout)
        build(replay, recording, cameras=cameras, progress=progress)
        recording.flush()
        recording.disconnect()
    return Path(path)


def _identity(replay: Replay) -> str:
    spec = replay.spec
    return f"{spec.track}-{spec.kind}-{spec.seed}-{int(replay.columns.checksum[-1]):08x}"


def send_scene(recording: rr.RecordingStream, track: Track, names: tuple[str, ...]) -> None:
    """Send all that never changes: the room, the cars' shapes, their eyes' places, chart styles."""
    recording.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_mesh(recording, paths.FLOOR, shapes.floor(track))
    log_mesh(recording, paths.WALLS, shapes.walls(track), WALL_OPACITY)
    rim = shapes.wheel()
    for slot, name in enumerate(names):
        colour = CAR_COLOURS[slot]
        log_mesh(recording, paths.body(slot), shapes.car_body(CAR, colour))
        log_mesh(recording, paths.shadow(slot), shapes.shadow(CAR), SHADOW_OPACITY)
        for which in paths.WHEELS:
            log_mesh(recording, paths.wheel(slot, which), rim)
        recording.log(
            paths.name_tag(slot),
            rr.Points3D([[0.0, 0.0, TAG_HEIGHT]], radii=0.0005, colors=[colour], labels=[name]),
            static=True,
        )
        for side in paths.EYES:
            _log_eye(recording, slot, side)
    for chart in (paths.PLOT_SPEED, paths.PLOT_GAP, paths.PLOT_STEERING):
        recording.log(
            chart,
            rr.SeriesLines(colors=CAR_COLOURS[: len(names)], names=list(names), widths=1.8),
            static=True,
        )


def log_mesh(
    recording: rr.RecordingStream, path: str, mesh: Mesh, opacity: float | None = None
) -> None:
    """Send a mesh that never changes its shape."""
    recording.log(
        path,
        rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.triangles,
            vertex_normals=mesh.normals,
            vertex_colors=mesh.colours,
            # Colours of vertices have no transparency of their own in the viewer.
            albedo_factor=None if opacity is None else (1.0, 1.0, 1.0, opacity),
        ),
        static=True,
    )


def _log_eye(recording: rr.RecordingStream, slot: int, side: str) -> None:
    focal = EYE_CAMERA.width / 2 / math.tan(EYE_CAMERA.field_of_view / 2)
    recording.log(
        paths.eye(slot, side),
        rr.Transform3D(
            translation=poses.eye_place(EYE_CAMERA, side), mat3x3=poses.eye_axes(EYE_CAMERA)
        ),
        rr.Pinhole(
            focal_length=focal,
            width=EYE_CAMERA.width,
            height=EYE_CAMERA.height,
            image_plane_distance=0.15,
        ),
        static=True,
    )


def send_obstacles(recording: rr.RecordingStream, replay: Replay) -> None:
    """Send the boxes or bot cars and where they are."""
    columns = replay.columns
    height = ObstacleConfig().height
    for index in range(columns.num_obstacles):
        path = paths.obstacle(index)
        if replay.spec.obstacle_kind == "bot":
            log_mesh(recording, path, shapes.car_body(CAR, BOT_COLOUR))
        else:
            length, width = 2 * replay.obstacle_sizes[index]
            box = shapes.box(float(length), float(width), height, BOX_COLOUR)
            log_mesh(recording, path, box)
        places = poses.places(columns.obstacle_x[:, index], columns.obstacle_y[:, index])
        turns = poses.about_z(columns.obstacle_yaw[:, index])
        if len(places) == 1:
            turn = rr.Quaternion(xyzw=turns[0])
            recording.log(path, rr.Transform3D(translation=places[0], quaternion=turn), static=True)
        else:
            recording.send_columns(
                path, times_of(replay), rr.Transform3D.columns(translation=places, quaternion=turns)
            )


def _send_motion(recording: rr.RecordingStream, replay: Replay) -> None:
    columns, times = replay.columns, times_of(replay)
    spin = poses.wheel_spin(replay)
    for slot in range(replay.num_cars):
        places = poses.places(columns.x[:, slot], columns.y[:, slot], columns.z[:, slot])
        angles = columns.yaw, columns.pitch, columns.roll
        turns = poses.turned(*(angle[:, slot] for angle in angles))
        recording.send_columns(
            paths.car(slot), times, rr.Transform3D.columns(translation=places, quaternion=turns)
        )
        for which, place in zip(paths.WHEELS, poses.WHEEL_PLACES, strict=True):
            steering = columns.steering[:, slot] * ("front" in which)
            recording.send_columns(
                paths.wheel(slot, which),
                times,
                rr.Transform3D.columns(
                    translation=np.broadcast_to(place, places.shape),
                    quaternion=poses.steered_and_spun(steering, spin[:, slot]),
                ),
            )
        _send_trail(recording, replay, slot, places)
        _send_fading(recording, replay, slot)
    path = story.chase_path(replay)
    recording.send_columns(
        paths.CHASE,
        times,
        rr.Transform3D.columns(
            translation=poses.places(path.x, path.y), quaternion=poses.about_z(path.yaw)
        ),
    )


def _send_fading(recording: rr.RecordingStream, replay: Replay, slot: int) -> None:
    """Send when a car turns to glass because it stands a penalty, and back."""
    frozen = replay.columns.penalty_s[:, slot] > 0
    changes = np.flatnonzero(np.diff(frozen, prepend=~frozen[:1]))
    opacity = np.where(frozen[changes], FROZEN_OPACITY, 1.0)
    factors = np.stack([np.ones_like(opacity)] * 3 + [opacity], axis=1)
    recording.send_columns(
        paths.body(slot),
        [rr.TimeColumn(paths.TIMELINE, duration=replay.times_s[changes])],
        rr.Mesh3D.columns(albedo_factor=np.round(255 * factors).astype(np.uint8)),
    )


def _send_trail(
    recording: rr.RecordingStream, replay: Replay, slot: int, places: np.ndarray
) -> None:
    """Send the path as one short strip a frame; the view shows the last seconds of them."""
    low = places + TRAIL_LIFT
    before = np.concatenate([low[:1], low[:-1]])
    jumped = np.linalg.norm(low - before, axis=1) > JUMP
    before[jumped] = low[jumped]
    strips = np.stack([before, low], axis=1).astype(np.float32)  # (num_frames, 2, 3)
    recording.log(
        paths.trail(slot),
        rr.LineStrips3D.from_fields(colors=[CAR_COLOURS[slot]], radii=[0.006]),
        static=True,
    )
    recording.send_columns(
        paths.trail(slot), times_of(replay), rr.LineStrips3D.columns(strips=list(strips))
    )


def _send_charts(recording: rr.RecordingStream, replay: Replay) -> None:
    charts = {
        paths.PLOT_SPEED: story.speeds(replay),
        paths.PLOT_GAP: story.gaps_m(replay),
        paths.PLOT_STEERING: np.degrees(replay.columns.steering),
    }
    for path, values in charts.items():
        batch = rr.Scalars.columns(scalars=values.astype(np.float32).reshape(-1))
        recording.send_columns(
            path, times_of(replay), batch.partition([replay.num_cars] * replay.num_frames)
        )


def _send_events(recording: rr.RecordingStream, replay: Replay) -> None:
    told = story.captions(replay)
    if not told:
        return
    recording.send_columns(
        paths.EVENTS,
        [rr.TimeColumn(paths.TIMELINE, duration=np.array([event.time_s for event, _ in told]))],
        rr.TextLog.columns(
            text=[text for _, text in told],
            level=[EVENT_LEVELS.get(event.kind, "INFO") for event, _ in told],
            color=[
                NEUTRAL if event.kind == "start" else CAR_COLOURS[event.car] for event, _ in told
            ],
        ),
    )


def classification(replay: Replay) -> str:
    """Return the result of the race as Markdown."""
    result, spec = replay.result, replay.spec
    kind = spec.kind.replace("_", " ")
    lines = [
        f"**{replay.track.title}**: {kind}, {laps(spec.laps)}, {spec.solver}, seed {spec.seed}",
        "",
        "| | driver | total | best lap | penalties |",
        "|---:|:---|---:|---:|---:|",
    ]
    for car in result.order:
        total = f"{car.total_s:.2f} s" if car.finished else laps(car.laps)
        best = f"{car.best_lap_s:.2f} s" if car.best_lap_s is not None else ""
        penalty = f"{car.penalty_s:g} s" if car.penalty_s else ""
        lines.append(f"| **{car.place}** | {plain(car.name)} | {total} | {best} | {penalty} |")
    if result.lead_changes:
        changes = "change" if result.lead_changes == 1 else "changes"
        lines += ["", f"{result.lead_changes} {changes} of the lead"]
    return "\n".join(lines)


def laps(count: int) -> str:
    """Return a number of laps in words."""
    return f"{count} lap" if count == 1 else f"{count} laps"


def plain(name: str) -> str:
    """Return a name that cannot break the table."""
    one_line = "".join(letter if letter.isprintable() else " " for letter in name)
    return "".join("\\" + letter if letter in "\\|*_`[]<>#" else letter for letter in one_line)
