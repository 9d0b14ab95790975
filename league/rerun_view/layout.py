"""Layout of a recording: where its entities are, and how the viewer shows them.

A race is laid out like a broadcast, training as the whole track and charts.
"""

from collections.abc import Sequence
from typing import Any, Literal

import rerun.blueprint as rrb

APPLICATION = "racing-league"
TIMELINE = "race_time"  # the only timeline, a duration from the start of the race

WORLD = "world"  # world frame, z up [m]
FLOOR = "world/track/floor"
WALLS = "world/track/walls"
OBSTACLES = "world/obstacles"
CHASE = "world/chase"  # a frame that follows the front of the race; the main view looks from it

TITLE = "race/classification"
EVENTS = "race/events"
PLOT_SPEED = "plots/speed"
PLOT_STEERING = "plots/steering"
PLOT_GAP = "plots/gap"
PLOT_REWARD = "plots/reward"
PLOT_TRAINING = "plots/completion/training"
PLOT_EVALUATION = "plots/completion/evaluation"

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
EYES = ("left", "right")

TRAIL_S = 2.5  # how much of its path each car trails [s]
Play = Literal["playing", "following"]
Room = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max [m]
BACKGROUND = (18, 22, 28)
CHASE_EYE = (-1.55, 0.0, 0.78)  # where the chase camera sits in the chase frame [m]
CHASE_TARGET = (1.35, 0.0, 0.05)  # what it looks at, in the chase frame [m]


def car(slot: int, *part: str) -> str:
    """Return a car's frame (its base, x ahead), or what lies in it, such as "wheels", which."""
    return "/".join([f"world/cars/car_{slot}", *part])


def trail(slot: int) -> str:
    """Return the path a car leaves, world frame."""
    return f"world/trails/car_{slot}"


def obstacle(index: int) -> str:
    """Return one box or bot car."""
    return f"{OBSTACLES}/{index}"


def broadcast(
    names: Sequence[str], room: Room, *, cameras: bool, live: bool = False
) -> rrb.Blueprint:
    """Return the layout of a race of drivers with these names.

    `cameras`: the recording holds the cars' eyes. `live`: follow the newest step instead of playing
    from the start.
    """
    num_cars = len(names)
    scenes = rrb.Tabs(
        _scene(num_cars, CHASE, "Chase", CHASE_EYE, CHASE_TARGET),
        _overview(num_cars, room),
        active_tab=0,
        name="Race",
    )
    left: list[Any] = [scenes]
    if cameras:
        left.append(_eyes(names))
    charts = rrb.Vertical(
        rrb.TextDocumentView(origin=TITLE, name="Order"),
        _chart(PLOT_SPEED, "Speed [m/s]"),
        _chart(PLOT_GAP, "Behind the leader [m]"),
        _chart(PLOT_STEERING, "Steering [deg]"),
        _list("Events"),
        row_shares=[1.5 + 0.2 * num_cars, 1, 1, 1, 1.2],
    )
    return _layout(
        rrb.Vertical(*left, row_shares=[2.6, 1.0] if cameras else [1.0]),
        charts,
        play="following" if live else "playing",
        loop=not live,
    )


def training(num_cars: int, room: Room) -> rrb.Blueprint:
    """Return the layout of cars that learn: the whole track, and their metrics.

    It plays at its own pace and waits at the end for more, which is smoother than following the
    newest batch.
    """
    charts = rrb.Vertical(
        _chart("plots/completion", "Completion [%]"),
        _chart(PLOT_REWARD, "Reward of an episode"),
        _chart(PLOT_SPEED, "Speed [m/s]"),
        _list("Evaluations"),
        row_shares=[1, 1, 1, 1],
    )
    return _layout(_overview(num_cars, room), charts, play="playing")


def _layout(
    scene: rrb.Container | rrb.View, charts: rrb.Container, play: Play, loop: bool = False
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(scene, charts, column_shares=[2.3, 1.0]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state=play,
            loop_mode="all" if loop else None,
        ),
    )


def _overview(num_cars: int, room: Room) -> rrb.Spatial3DView:
    x_min, y_min, x_max, y_max = room
    middle = ((x_min + x_max) / 2, (y_min + y_max) / 2)
    reach = max(x_max - x_min, (y_max - y_min) * 1.6)
    eye = (middle[0], y_min - 0.45 * reach, 0.72 * reach)
    return _scene(num_cars, WORLD, "Whole track", eye, (*middle, 0.0))


Point = tuple[float, float, float]


def _scene(num_cars: int, origin: str, name: str, eye: Point, target: Point) -> rrb.Spatial3DView:
    # The eyes' pictures would hang in front of the cars in 3D; they have views of their own.
    hidden = [f"- /{car(slot, 'eyes')}/**" for slot in range(num_cars)]
    window = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        origin=origin,
        contents=[f"+ /{WORLD}/**", *hidden],
        name=name,
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
        overrides={trail(slot): window for slot in range(num_cars)},
    )


def _eyes(names: Sequence[str]) -> rrb.Container:
    pairs = []
    for slot, name in enumerate(names):
        views = [
            rrb.Spatial2DView(origin=car(slot, "eyes", side), name=f"{name}: {side} eye")
            for side in EYES
        ]
        pairs.append(rrb.Horizontal(*views, name=name))
    if len(names) <= 2:
        return rrb.Horizontal(*pairs)
    return rrb.Tabs(*pairs, name="Eyes")


def _chart(origin: str, name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _list(name: str) -> rrb.TextLogView:
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin=EVENTS, name=name, columns=columns)
