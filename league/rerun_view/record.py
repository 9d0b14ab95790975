"""A replay as a Rerun recording: whole columns at once, with what the cars sensed."""

import io
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from league import times
from league.atomic_file import replacing
from league.errors import ReplayError
from league.replay import Replay, broadcast
from league.rerun_view import layout
from league.rerun_view.scene import EYE_CAMERA, NEUTRAL, SceneWriter, positions, rotation
from league.sim import lidar
from league.sim.camera.renderer import Renderer
from league.sim.camera.scene import CAR_COLOURS
from league.sim.config import LidarConfig
from league.video.film import Mp4

FROZEN_OPACITY = 0.35
EVENT_LEVELS = {"crash": "ERROR", "off_track": "WARN", "contact": "WARN", "driver_fault": "ERROR"}
BATCH = 16  # frames rendered at a time; few, so that they stay in the cache
LIDAR_BATCH = 1024
LIDAR_EVERY = 2  # one scan for so many frames (7.5 Hz of 15; the sensor's own clock is 10 Hz)


def save(replay: Replay, path: str | os.PathLike[str], *, cameras: bool = True) -> Path:
    """Write a replay as a .rrd file, whole or not at all, and return its path.

    The films of the cars' cameras, which take most of the time, are omitted if `cameras` is False.
    """
    spec = replay.spec
    identity = f"{spec.track}-{spec.kind}-{spec.seed}-{int(replay.columns.checksum[-1]):08x}"
    recording = rr.RecordingStream(layout.APPLICATION, recording_id=identity)
    views = layout.broadcast(replay.names, replay.track.room, cameras=cameras)
    with replacing(path, "the recording", ReplayError) as file:
        recording.save(file, default_blueprint=views)
        writer = SceneWriter(recording, replay.track, replay.names, replay.step_hz)
        _send_race(writer, replay)
        for line in broadcast.of_replay(replay):
            send_line(writer, line)
        _send_lidar(writer, replay)
        if cameras:
            _send_eyes(writer, replay)
        recording.flush()
        recording.disconnect()
    return Path(path)


def _send_race(writer: SceneWriter, replay: Replay) -> None:
    times, columns, world = replay.times_s, replay.columns, replay.worlds()
    writer.send_cars(times, world.cars)
    if columns.num_obstacles:
        bots, still = replay.spec.obstacle_kind == "bot", len(columns.obstacle_x) == 1
        things = world.obstacles[:1] if still else world.obstacles
        writer.send_obstacles(None if still else times, things, bots=bots)
    writer.send_chart(layout.PLOT_SPEED, times, replay.speeds)
    writer.send_chart(layout.PLOT_GAP, times, replay.gaps_m)
    writer.send_chart(layout.PLOT_STEERING, times, np.degrees(columns.steering))
    chase = broadcast.chase_path(replay)
    writer.send_poses(layout.CHASE, times, positions(chase.x, chase.y), rotation(chase.yaw))
    for slot in range(replay.num_cars):
        # A car that stands a penalty is transparent.
        frozen = columns.penalty_s[:, slot] > 0
        changes = np.flatnonzero(np.diff(frozen, prepend=~frozen[:1]))
        factors = np.full((len(changes), 4), 255, np.uint8)
        factors[frozen[changes], 3] = round(255 * FROZEN_OPACITY)
        body, shades = layout.car(slot, "body"), rr.Mesh3D.columns(albedo_factor=factors)
        writer.send(body, times[changes], shades)
    _send_order(writer, replay, chase.fights)


def _send_order(writer: SceneWriter, replay: Replay, fights: Sequence[str]) -> None:
    """Send the order and the fight shown, and the classification when they have raced."""
    head, names = _head(replay), replay.names
    texts = [
        running_order(head, [names[slot] for slot in order], fight)
        for order, fight in zip(replay.running_order, fights, strict=True)
    ]
    # The last frame is the classification's, also where the order changed in it.
    texts[-1] = classification(replay)
    changes = [k for k in range(len(texts)) if k == 0 or texts[k] != texts[k - 1]]
    writer.send_title(replay.times_s[changes], [texts[k] for k in changes])


def send_line(writer: SceneWriter, line: broadcast.Remark) -> None:
    """Add a line of the race's story to the list of events."""
    colour = NEUTRAL if line.kind == "start" else CAR_COLOURS[line.car]
    level = EVENT_LEVELS.get(line.kind, "INFO")
    writer.send_event(line.time_s, line.stamped, colour, level)


def _send_lidar(writer: SceneWriter, replay: Replay) -> None:
    """Send what each car's rear lidar meets, as points in the car's frame."""
    cfg = LidarConfig(noise=0.0)
    times = replay.times_s[::LIDAR_EVERY]
    angles = np.array(lidar.beam_angles(cfg), dtype=np.float32)
    for slot in range(replay.num_cars):
        scans = []
        for start in range(0, len(times), LIDAR_BATCH):
            world = replay.at(times[start : start + LIDAR_BATCH])
            scans.append(lidar.scan(replay.tracks, replay.sim, cfg, world, slot))
        ranges = np.concatenate(scans)  # (num_scans, beams)
        hit = ranges < cfg.max_range
        ahead, aside = cfg.forward + ranges * np.cos(angles), ranges * np.sin(angles)
        points = positions(ahead, aside, cfg.up)[hit].astype(np.float32)
        bright = tuple((part + 255) // 2 for part in CAR_COLOURS[slot])
        style = rr.Points3D.from_fields(colors=[bright], radii=[0.009])
        writer.recording.log(layout.car(slot, "lidar"), style, static=True)
        columns = rr.Points3D.columns(positions=points).partition(hit.sum(axis=1))
        writer.send(layout.car(slot, "lidar"), times, columns)


def _send_eyes(writer: SceneWriter, replay: Replay) -> None:
    """Send each eye's film and which of its pictures belongs to which frame."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        films = list(pool.map(lambda slot: _film(replay, slot), range(replay.num_cars)))
    for slot, pair in enumerate(films):
        for side, content in zip(layout.EYES, pair, strict=True):
            video = rr.AssetVideo(contents=content, media_type="video/mp4")
            writer.recording.log(layout.car(slot, "eyes", side), video, static=True)
            stamps = rr.VideoFrameReference.columns_nanos(video.read_frame_timestamps_nanos())
            writer.send(layout.car(slot, "eyes", side), replay.times_s, stamps)


def _film(replay: Replay, slot: int) -> tuple[bytes, bytes]:
    """Return what a car's left and right eye saw, as two MP4 files."""
    renderer = Renderer(replay.tracks, replay.sim, EYE_CAMERA)
    films = (io.BytesIO(), io.BytesIO())
    size = EYE_CAMERA.width, EYE_CAMERA.height
    left, right = (Mp4(film, size, replay.step_hz, crf=29, preset="ultrafast") for film in films)
    with left, right:
        for start in range(0, replay.num_frames, BATCH):
            world = replay.at(replay.times_s[start : start + BATCH])
            for planes in renderer.render(world, slot):  # (6, height, width)
                left.add(cv2.merge(list(planes[:3])))
                right.add(cv2.merge(list(planes[3:])))
    return films[0].getvalue(), films[1].getvalue()


def classification(replay: Replay) -> str:
    """Return the result of the race as Markdown."""
    result = replay.result
    heads = ["| | driver | total | best lap | penalties |", "|---:|:---|---:|---:|---:|"]
    lines = [_head(replay), "", *heads]
    for car in result.order:
        total = f"{car.total_s:.2f} s" if car.finished else times.counted(car.laps, "lap")
        best = f"{car.best_lap_s:.2f} s" if car.best_lap_s is not None else ""
        penalty = f"{car.penalty_s:g} s" if car.penalty_s else ""
        lines.append(f"| **{car.place}** | {escaped(car.name)} | {total} | {best} | {penalty} |")
    if result.lead_changes:
        lines += ["", f"{times.counted(result.lead_changes, 'change')} of the lead"]
    return "\n".join(lines)


def running_order(head: str, names: Sequence[str], fight: str = "") -> str:
    """Return who is where as Markdown, the leader first, and the fight that is shown."""
    places = [f"{place}. {escaped(name)}" for place, name in enumerate(names, 1)]
    return "\n".join([head, "", *places, *(["", escaped(fight)] if fight else [])])


def _head(replay: Replay) -> str:
    spec = replay.spec
    kind, laps = spec.kind.replace("_", " "), times.counted(spec.laps, "lap")
    return f"**{replay.track.title}**: {kind}, {laps}, {spec.solver}, seed {spec.seed}"


def escaped(name: str) -> str:
    """Return a name that cannot break the table."""
    one_line = "".join(letter if letter.isprintable() else " " for letter in name)
    return "".join("\\" + letter if letter in "\\|*_`[]<>#" else letter for letter in one_line)
