"""How fast and how right pictures are: pairs per second, against PyBullet, against rays."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pybullet

from benchmarks.report import fastest, figure, heading
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.camera import scene
from league.sim.camera.renderer import Renderer
from league.sim.config import CameraConfig, SimConfig
from league.sim.records import OBSTACLE, World
from league.track import files, markings
from league.track.track import TrackSet
from tests.sim.raycast import RayRenderer

SCENES = 200
EDGE = 12
"""A pixel is away from edges if the 3 x 3 pixels round it, in the ray's picture, spread by less."""


def one_ahead(tracks: TrackSet, num_worlds: int) -> tuple[SimConfig, World]:
    """Return worlds with a car to look from and one in its view, 0.6 to 2 m ahead, all over."""
    sim = SimConfig(kind="head_to_head", num_cars=2)
    world = _on_the_grid(tracks, sim, num_worlds)
    draw = np.random.default_rng(3)
    s = draw.uniform(0, tracks.tracks[0].length, (num_worlds, 1))
    gap = draw.uniform(0.6, 2.0, (num_worlds, 1))
    frame, cars = tracks.at(world.track, np.concatenate([s, s + gap], axis=1)), world.cars
    cars["x"], cars["y"], cars["steering"] = frame.x, frame.y, 0.2
    cars["yaw"] = np.arctan2(frame.sin, frame.cos)
    # The one looks at the other, as if turning in behind it.
    away_x, away_y = np.diff(frame.x)[:, 0], np.diff(frame.y)[:, 0]
    cars["yaw"][:, 0] = np.arctan2(away_y, away_x) + 0.1
    return sim, world


def behind(world: World) -> World:
    """Return the worlds with the second car far behind the first."""
    world = world.copy()
    first, second = world.cars[:, 0], world.cars[:, 1]
    second["x"] = first["x"] - 100 * np.cos(first["yaw"])
    second["y"] = first["y"] - 100 * np.sin(first["yaw"])
    return world


def _on_the_grid(tracks: TrackSet, sim: SimConfig, num_worlds: int) -> World:
    return RaceEnv(tracks, EnvConfig(sim=sim), num_worlds=num_worlds).world.copy()


def check_car_is_seen(seen: np.ndarray, alone: np.ndarray) -> None:
    """Stop unless every picture has contrast and shows the car."""
    changed = np.abs(seen.astype(int) - alone) > 5
    assert changed.sum(axis=(1, 2, 3)).min() > 20, "a picture does not show its car"
    assert seen.std(axis=(1, 2, 3)).min() > 10, "a picture is blank"


def random_scenes(tracks: TrackSet, number: int) -> tuple[SimConfig, World]:
    """Return worlds with three cars and two boxes near each other, none overlapping."""
    draw = np.random.default_rng(0)
    track = tracks.tracks[0]
    x_min, y_min, x_max, y_max = track.room
    cars, boxes = [], []
    for _ in range(number):
        point = draw.integers(len(track.center))
        heading_here = math.atan2(track.tangent[point, 1], track.tangent[point, 0])
        x, y = track.center[point] + draw.uniform(-0.3, 0.3, 2)
        me = (x, y, heading_here + draw.normal(0, 0.3))
        others: list = []
        while len(others) < 4:
            far, turn = draw.uniform(0.2, 3.0), me[2] + draw.uniform(-1.2, 1.2)
            x, y = me[0] + far * math.cos(turn), me[1] + far * math.sin(turn)
            inside = x_min + 0.3 < x < x_max - 0.3 and y_min + 0.3 < y < y_max - 0.3
            if inside and all(math.dist((x, y), one[:2]) > 0.45 for one in (me, *others)):
                others.append((x, y, draw.uniform(-math.pi, math.pi)))
        cars.append([me, *others[:2]])
        boxes.append(others[2:])
    # A race among cars has no boxes: they are added by hand.
    sim = SimConfig(kind="head_to_head", num_cars=3)
    world = _on_the_grid(tracks, sim, number)
    world = replace(world, obstacles=np.zeros((number, 2), OBSTACLE))
    for stood, places in ((world.cars, cars), (world.obstacles, boxes)):
        for k, name in enumerate(("x", "y", "yaw")):
            stood[name] = np.array(places)[..., k]
    world.obstacles["half_length"], world.obstacles["half_width"] = 0.15, 0.2
    world.cars["steering"] = draw.uniform(-0.5, 0.5, (number, 3))
    return sim, world


def speed(tracks: TrackSet) -> None:
    """Print pairs per second at the fastest of 40, one world a call and 64 worlds a call."""
    for width, height, goal in ((160, 120, 3_000), (64, 48, 12_000)):
        camera = CameraConfig(width=width, height=height)
        for num_worlds in (1, 64):
            sim, world = one_ahead(tracks, 64)
            renderer = Renderer(tracks, sim, camera)
            seen, alone = renderer.render(world, 0), renderer.render(behind(world), 0)
            check_car_is_seen(seen, alone)
            if num_worlds == 64:
                taken = fastest(lambda: renderer.render(world, 0))  # noqa: B023
            else:
                # One world a call, each of the 64 in turn.
                singles = [world.row(index) for index in range(64)]
                taken = fastest(lambda: [renderer.render(one, 0) for one in singles])  # noqa: B023
            name = f"stereo {width}x{height}, a car in view, {num_worlds} world(s) a call"
            figure(name, 64 / taken, "pairs/s", goal)


class TinyScene:
    """The same scene in PyBullet: floor with its texture, four walls, a car of the same solids."""

    def __init__(self, tracks: TrackSet, world: World, camera: CameraConfig) -> None:
        self._camera = camera
        self._client = pybullet.connect(pybullet.DIRECT)
        track = tracks.tracks[int(world.track[0])]
        x_min, y_min, x_max, y_max = track.room
        middle = ((x_min + x_max) / 2, (y_min + y_max) / 2)
        half = ((x_max - x_min) / 2, (y_max - y_min) / 2)
        self._floor(track, middle, half)
        thick, high = 0.02, scene.WALL_HEIGHT / 2
        for sign in (-1, 1):
            x, y = middle[0] + sign * (half[0] + thick), middle[1] + sign * (half[1] + thick)
            self._box((x, middle[1], high), (thick, half[1], high), track.colours.wall)
            self._box((middle[0], y, high), (half[0], thick, high), track.colours.wall)
        x, y, yaw = _place(world, 1)
        turn = (0, 0, math.sin(yaw / 2), math.cos(yaw / 2))
        for solid in scene.CAR.solids:
            self._solid(solid, (x, y, 0), turn)
        self._eyes(world)

    def _floor(self, track, middle: tuple, half: tuple) -> None:
        with tempfile.TemporaryDirectory() as folder:
            floor = markings.floor(track, 0.01, colour=True).image
            picture = str(Path(folder) / "floor.png")
            cv2.imwrite(picture, floor[..., ::-1])
            mesh = {
                "vertices": [(-half[0], -half[1], 0), (half[0], -half[1], 0), (half[0], half[1], 0),
                             (-half[0], half[1], 0)],
                "indices": [0, 1, 2, 0, 2, 3],
                "uvs": [(0, 1), (1, 1), (1, 0), (0, 0)],
                "normals": [(0, 0, 1)] * 4,
            }  # fmt: skip
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH, **mesh, physicsClientId=self._client
            )
            body = pybullet.createMultiBody(
                baseVisualShapeIndex=shape,
                basePosition=(*middle, 0),
                physicsClientId=self._client,
            )
            texture = pybullet.loadTexture(picture, physicsClientId=self._client)
            pybullet.changeVisualShape(
                body, -1, textureUniqueId=texture, physicsClientId=self._client
            )

    def _solid(self, solid: scene.Solid, place: tuple, turn: tuple) -> None:
        """Put up one solid of a car as a mesh, each face with its own corners and normal."""
        points = solid.vertices + np.array([*(solid.pivot or (0.0, 0.0)), 0.0])
        corners, normals, indices = [], [], []
        for face, plane in zip(solid.faces, solid.planes, strict=True):
            first, ring = len(corners), points[list(face)]
            if np.cross(ring[1] - ring[0], ring[2] - ring[1]) @ plane[:3] < 0:
                ring = ring[::-1]
            corners += ring.tolist()
            normals += [plane[:3].tolist()] * len(ring)
            for index in range(1, len(ring) - 1):
                indices += [first, first + index, first + index + 1]
        number = solid.paints[0]
        colour = scene.PAINTS[number] if number >= 0 else scene.CAR_COLOURS[1]
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            indices=indices,
            normals=normals,
            uvs=[(0.0, 0.0)] * len(corners),
            rgbaColor=[*(part / 255 for part in colour), 1],
            physicsClientId=self._client,
        )
        pybullet.createMultiBody(
            baseVisualShapeIndex=shape,
            basePosition=place,
            baseOrientation=turn,
            physicsClientId=self._client,
        )

    def _box(self, place: tuple, half: tuple, colour: tuple) -> None:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=list(half),
            rgbaColor=[*(part / 255 for part in colour), 1],
            physicsClientId=self._client,
        )
        pybullet.createMultiBody(
            baseVisualShapeIndex=shape,
            basePosition=place,
            physicsClientId=self._client,
        )

    def _eyes(self, world: World) -> None:
        cfg = self._camera
        x, y, yaw = _place(world, 0)
        cos, sin = math.cos(yaw), math.sin(yaw)
        self._views = []
        for eye in (cfg.baseline / 2, -cfg.baseline / 2):
            place = (x + cos * cfg.forward - sin * eye, y + sin * cfg.forward + cos * eye, cfg.up)
            flat, down = math.cos(cfg.pitch), -math.sin(cfg.pitch)
            target = (place[0] + cos * flat, place[1] + sin * flat, place[2] + down)
            self._views.append(pybullet.computeViewMatrix(place, target, (0, 0, 1)))
        high = 2 * math.atan(math.tan(cfg.field_of_view / 2) * cfg.height / cfg.width)
        aspect = cfg.width / cfg.height
        self._lens = pybullet.computeProjectionMatrixFOV(math.degrees(high), aspect, 0.02, 300)

    def pair(self) -> list[np.ndarray]:
        """Return both eyes' pictures as RGB."""
        found = []
        for view in self._views:
            _, _, image, _, _ = pybullet.getCameraImage(
                self._camera.width,
                self._camera.height,
                view,
                self._lens,
                shadow=0,
                flags=pybullet.ER_NO_SEGMENTATION_MASK,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self._client,
            )
            shape = (self._camera.height, self._camera.width, 4)
            found.append(np.asarray(image, np.uint8).reshape(shape)[..., :3])
        return found

    def close(self) -> None:
        """Give PyBullet's client back."""
        pybullet.disconnect(self._client)


def against_bullet(tracks: TrackSet, folder: Path | None = None) -> None:
    """Print how much faster a pair is than two pictures of PyBullet's software renderer."""
    camera = CameraConfig()
    sim, worlds = one_ahead(tracks, 8)
    world = worlds.row(0)
    renderer = Renderer(tracks, sim, camera)
    check_car_is_seen(renderer.render(world, 0), renderer.render(behind(world), 0))
    tiny, tiny_empty = (TinyScene(tracks, one, camera) for one in (world, behind(world)))
    theirs, bare = (np.stack(one.pair()) for one in (tiny, tiny_empty))
    assert theirs.std() > 10 and (np.abs(theirs.astype(int) - bare) > 5).sum() > 60
    ours = renderer.render(world, 0)[0]
    gray = theirs @ np.array(scene.LUMA)
    alike = np.corrcoef(ours.reshape(-1), gray.reshape(-1))[0, 1]
    assert alike > 0.6, f"the two do not show the same scene: correlation {alike:.2f}"
    if folder is not None:
        pictures = np.concatenate([np.concatenate(part, axis=1) for part in (ours, gray)])
        cv2.imwrite(str(folder / "cameras.png"), pictures.astype(np.uint8))
    # Turn and turn about, in blocks of about the same time, so that both meet the same load.
    slow, fast = math.inf, math.inf
    for _ in range(15):
        slow = min(slow, fastest(tiny.pair, 2))
        fast = min(fast, fastest(lambda: [renderer.render(world, 0) for _ in range(60)], 2) / 60)
    figure("one pair 160x120, PyBullet's software renderer", 1e3 * slow, "ms")
    figure("one pair 160x120, ours, one world a call", 1e3 * fast, "ms")
    figure("ours is faster by", slow / fast, "times", 100)
    figure("likeness of the two pictures (correlation)", alike, "")
    for one in (tiny, tiny_empty):
        one.close()


def agreement(tracks: TrackSet) -> None:
    """Print how far the painted pictures are from the cast ones."""
    sim, world = random_scenes(tracks, SCENES)
    for width, height in ((160, 120), (64, 48)):
        camera = CameraConfig(width=width, height=height)
        painted = Renderer(tracks, sim, camera).render(world, 0)
        cast = RayRenderer(tracks, sim, camera).render(world, 0)
        square = np.ones((3, 3), np.uint8)
        flat = cast.reshape(-1, height, width)
        spread = [cv2.dilate(image, square) - cv2.erode(image, square) for image in flat]
        away = (np.stack(spread) < EDGE).reshape(cast.shape)
        off = np.abs(painted.astype(int) - cast)
        size = f"{width}x{height}"
        figure(f"painted - cast, {SCENES} scenes {size}", off[away].mean(), "of 255", 2, most=True)
        worst = max(one[where].mean() for one, where in zip(off, away, strict=True))
        figure(f"  the worst scene of them, {size}", worst, "of 255", 2, most=True)
        figure(f"  with edges, {size}", off.mean(), "of 255")
        figure(f"  share of pixels away from edges, {size}", 100 * away.mean(), "%")


def _place(world: World, car: int) -> list[float]:
    return [float(world.cars[name][0, car]) for name in ("x", "y", "yaw")]


def main(folder: Path | None = None) -> None:
    """Print all figures of the cameras; with a folder, leave the two renderers' pictures there."""
    heading("Cameras")
    tracks = TrackSet(files.load("reinvent_2018"))
    speed(tracks)
    against_bullet(tracks, folder)
    agreement(tracks)


if __name__ == "__main__":
    main()
