import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from league import rerun_view
from league.errors import ReplayError
from league.rerun_view import layout, record, scene, viewer
from league.sim.camera.scene import CAR
from league.track import files
from tests.recorded import by_hand, moved, raced
from tests.recordings import rows_of, texts_of


def listening(port: int) -> list[str]:
    """Return the local addresses, in hex, that listen on a port."""
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            words = line.split()
            address, at = words[1].split(":")
            if words[3] == "0A" and int(at, 16) == port:
                found.append(address)
    return found


def get(url: str, **headers: str):
    request = urllib.request.Request(url, headers=headers)
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    return opener.open(request, timeout=20)


def test_a_recording_holds_every_car_on_one_timeline(tmp_path):
    made = raced()
    path = rerun_view.save(made, tmp_path / "a.rrd", cameras=False)
    rows = rows_of(path)
    frames = made.num_frames
    for slot in range(2):
        assert rows[layout.car(slot)] == frames
        assert rows[layout.trail(slot)] == frames
        assert rows[layout.car(slot, "lidar")] == (frames + 1) // 2
        for which in layout.WHEELS:
            assert rows[layout.car(slot, "wheels", which)] == frames
    for chart in (layout.PLOT_SPEED, layout.PLOT_GAP, layout.PLOT_STEERING, layout.CHASE):
        assert rows[chart] == frames
    assert rows[layout.EVENTS] >= 2
    assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]
    reader = RrdReader(path)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1


def test_the_eyes_are_films_with_a_picture_for_each_frame(tmp_path):
    made = by_hand(9, lambda w, n: moved(w, x=[3.0 + 0.1 * n, 2.0]))
    path = rerun_view.save(made, tmp_path / "a.rrd")
    rows = rows_of(path)
    for slot in range(2):
        for side in layout.EYES:
            assert rows[layout.car(slot, "eyes", side)] == 9


def test_obstacles_that_stand_are_sent_once(tmp_path):
    made = by_hand(4, cars=1)
    assert made.columns.num_obstacles == 3
    rows = rows_of(rerun_view.save(made, tmp_path / "a.rrd", cameras=False))
    assert not [name for name in rows if name.startswith(layout.OBSTACLES)]


def test_a_recording_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(ReplayError, match="cannot be written"):
        rerun_view.save(by_hand(2), tmp_path / "taken", cameras=False)
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


def test_names_cannot_break_the_classification():
    made = raced()
    order = tuple(car.model_copy(update={"name": "a|b\n# c"}) for car in made.result.order)
    result = made.result.model_copy(update={"order": order})
    table = record.classification(replace(made, result=result))
    rows = [line for line in table.splitlines() if line.startswith("| **")]
    assert len(rows) == 2
    assert all("a\\|b \\# c" in row for row in rows)


# Shapes and poses.


def test_the_road_is_as_large_as_its_length_times_its_width():
    track = files.load("reinvent_2018")
    mesh = scene.floor(track)
    colour = np.array([*track.colours.road, 255])
    road = mesh.triangles[(mesh.colours[mesh.triangles[:, 0]] == colour).all(axis=1)]
    a, b, c = (mesh.vertices[road[:, corner], :2] for corner in range(3))
    u, v = b - a, c - a
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2
    # Lines of 76 mm inside the border on both sides leave 0.762 - 0.152 m of road.
    assert area == pytest.approx(track.length * (0.762 - 2 * 0.076), rel=0.02)


def test_normals_of_a_car_point_outward():
    mesh = scene.car_body(CAR, (200, 0, 0))
    top = mesh.vertices[:, 2] > 0.177
    assert mesh.normals[top & (np.abs(mesh.normals[:, 2]) > 0.9), 2].min() > 0.9
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)
    assert mesh.triangles.max() < len(mesh.vertices)


def test_wheels_roll_as_far_as_the_car_drives():
    # 1.5 m/s for 10 steps of 1/15 s is 1 m; over a radius of 36 mm that is 27.8 rad.
    made = by_hand(11, lambda w, _: moved(w, velocity_x=[1.5, 0.0], yaw=[0.0, 0.0]))
    assert scene.wheel_spin(made.worlds().cars, 15)[-1] == pytest.approx([1 / 0.036, 0.0])


def test_a_wheel_is_turned_then_rolled_about_its_own_axle():
    x, y, z, w = scene.rotation(np.array(np.pi / 2), np.array(np.pi / 2))
    # Its axle (y in its own frame) points along -x after a quarter turn to the left.
    turned = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    assert turned == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)


# Serving.


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    path = tmp_path_factory.mktemp("served") / "a.rrd"
    rerun_view.save(by_hand(3), path, cameras=False)
    with viewer.serve(path) as running:
        yield running


def test_the_viewer_and_the_race_come_from_one_origin(server):
    page = get(server.origin + "/").read().decode()
    assert "re_viewer.js" in page
    assert get(server.origin + "/race.rrd").read()[:4] == b"RRF2"
    wasm = get(server.origin + "/re_viewer_bg.wasm").read()
    assert wasm[:4] == b"\0asm"
    assert server.url.startswith(f"http://127.0.0.1:{server.port}/?url=http%3A%2F%2F127.0.0.1")


def test_the_page_may_fetch_nothing_from_elsewhere(server):
    answer = get(server.origin + "/")
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    assert "http" not in policy
    head = answer.read().decode().split("</head>")[0]
    assert "https://" not in head


def test_only_this_machine_can_connect(server):
    assert listening(server.port) == ["0100007F"]


def test_other_paths_and_other_names_are_refused(server):
    for path in ("/../../etc/passwd", "/race.rrd/..", "/league"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(server.origin + path)
    with pytest.raises(urllib.error.HTTPError, match="403"):
        get(server.origin + "/race.rrd", Host="evil.example")


def test_a_missing_recording_and_a_taken_port_are_one_sentence(tmp_path, server):
    with pytest.raises(ReplayError, match="no recording"):
        viewer.serve(tmp_path / "none.rrd")
    path = rerun_view.save(by_hand(2), tmp_path / "a.rrd", cameras=False)
    with pytest.raises(ReplayError, match="listened on"):
        viewer.serve(path, port=server.port)


def test_a_closed_server_is_gone(tmp_path):
    path = rerun_view.save(by_hand(2), tmp_path / "a.rrd", cameras=False)
    running = viewer.serve(path)
    threading.Timer(0.2, running.close).start()
    running.wait()
    assert listening(running.port) == []


def test_without_a_display_no_window_is_tried(monkeypatch, tmp_path):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ReplayError, match="--web"):
        rerun_view.open_viewer(tmp_path / "a.rrd")


# Live.


class Window:
    """A viewer's window with a file as its recording."""

    has_window, address = True, ""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self.recording = recording

    def close(self) -> None:
        self.recording.flush()
        self.recording.disconnect()


def test_a_live_race_sends_each_step_and_touches_nothing(tmp_path):
    behind = (-1.0, -1.0, -1.0, -1.0, 9.0, 9.0)  # it passes in the fifth step
    made = by_hand(6, lambda w, n: moved(w, x=[3.0 + 0.1 * n, 2.0], distance=[0.0, behind[n]]))
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    live = rerun_view.Live(made.spec, made.track, Window(recording))
    worlds = made.worlds()
    for number in range(6):
        live.add(worlds.row(number))
    live.close()
    rows = rows_of(tmp_path / "live.rrd")
    assert rows[layout.car(0)] == rows[layout.CHASE] == rows[layout.PLOT_GAP] == 6
    head = "# re:Invent 2018\n\n**head to head**, 2 laps, live\n\n"
    # Who stands is taken to do 0.5 m/s: a metre is 2 s. Nine metres are no fight any more.
    before = "1. driver_0\n2. driver_1\n\ndriver_1 chases driver_0, 2.0 s"
    assert texts_of(tmp_path / "live.rrd", layout.TITLE) == [
        (0, head + before.replace("_", "\\_")),
        (266_666_666, head + "1. driver_1\n2. driver_0".replace("_", "\\_")),
    ]
    assert live.how_to_end == "The window stays open until you close it."


def test_a_live_race_is_served_to_this_machine_only():
    made = by_hand(2)
    with closing(rerun_view.Live.start(made.spec, made.track, window=False)) as live:
        live.add(made.at(np.array([0.0])))
        assert live.how_to_end == "The page stays as it is until you press Ctrl-C."
        ports = [int(part.split("/")[0]) for part in _ports(live.address)]
        assert len(ports) == 2
        for port in ports:
            assert listening(port) == ["0100007F"]
    for port in ports:
        with pytest.raises(OSError):
            socket.create_connection(("127.0.0.1", port), timeout=2).close()


def _ports(address: str) -> list[str]:
    return [part.split("&")[0] for part in unquote(address).split("127.0.0.1:")[1:]]


def rotated(quaternion: np.ndarray, vector: tuple[float, float, float]) -> list[float]:
    """Return a vector turned by a quaternion (x, y, z, w)."""
    axis, w = quaternion[:3], quaternion[3]
    across = np.cross(axis, vector)
    return (np.array(vector) + 2 * w * across + 2 * np.cross(axis, across)).tolist()


def test_cars_lean_and_nose_down_as_their_records_say():
    half = np.pi / 2
    level, right, down = (
        scene.rotation(*map(np.array, angles))
        for angles in ((half, 0, 0), (0, 0, 0.3), (0, 0.3, 0))
    )
    ahead, up = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    assert rotated(level, ahead) == pytest.approx([0.0, 1.0, 0.0])
    assert rotated(right, up) == pytest.approx([0.0, -np.sin(0.3), np.cos(0.3)])
    assert rotated(down, ahead) == pytest.approx([np.cos(0.3), 0.0, -np.sin(0.3)])
    # First the heading, then the pitch about the new axle: the nose goes down, not aside.
    both = scene.rotation(np.array(half), np.array(0.3), np.array(0.0))
    assert rotated(both, ahead) == pytest.approx([0.0, np.cos(0.3), -np.sin(0.3)])


def test_classification_is_shown_at_the_end_and_the_order_before(tmp_path):
    made = raced()
    path = rerun_view.save(made, tmp_path / "a.rrd", cameras=False)
    texts = texts_of(path, layout.TITLE)
    assert len(texts) >= 2 and texts[0][0] == 0
    assert all("| total |" not in text for _, text in texts[:-1])
    assert "| total |" in texts[-1][1]
    assert texts[-1][0] == pytest.approx(1e9 * made.times_s[-1])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends children by itself")
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGKILL])
def test_no_server_outlives_a_program_that_is_ended(sign):
    program = (
        "import time\nfrom league.rerun_view import layout\n"
        "from league.rerun_view.viewer import Stream\n"
        "stream = Stream(layout.broadcast(['a'], (0, 0, 1, 1), cameras=False), window=False)\n"
        "print(stream._child.pid, flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=-1, text=True) as parent:
        assert parent.stdout is not None
        server = Path("/proc", parent.stdout.readline().strip())
        assert server.exists()
        parent.send_signal(sign)
    for _ in range(100):
        if not server.exists() or ") Z " in (server / "stat").read_text():
            return
        time.sleep(0.05)
    pytest.fail("the server still runs")
