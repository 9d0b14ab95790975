"""Child processes: immune to Ctrl-C, replaced when they die, ended with their parent."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from league import subprocesses
from league.errors import ConfigError

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a server and /proc")


def report(pipe: Connection) -> None:
    """Send the process ids after a Ctrl-C, then wait until the end is asked for."""
    os.kill(os.getpid(), signal.SIGINT)
    pipe.send((os.getpid(), os.getppid()))
    pipe.recv()


def process_ids() -> tuple[int, int]:
    """Return the id of a fresh process that has ended, and of its parent."""
    ours, theirs = subprocesses.CONTEXT.Pipe()
    process = subprocesses.start(report, theirs)
    theirs.close()
    answer = ours.recv()
    ours.send("end")
    process.join(10.0)
    assert process.exitcode == 0
    return answer


def stuck(pipe: Connection) -> None:
    pipe.send((os.getpid(), os.getppid()))
    while True:
        time.sleep(1.0)


def gone(pid: int) -> bool:
    """Return whether a process comes to its end within half a minute."""
    give_up = time.monotonic() + 30.0
    while time.monotonic() < give_up:
        try:
            if " Z " in Path(f"/proc/{pid}/stat").read_text():
                return True
        except OSError:
            return True
        time.sleep(0.02)
    return False


def test_a_process_survives_ctrl_c_which_is_heard_here_as_before():
    def mine(_number: object, _frame: object) -> None:
        heard.append(True)

    heard: list[bool] = []
    before = signal.signal(signal.SIGINT, mine)
    try:
        assert process_ids()[0] != os.getpid()
        os.kill(os.getpid(), signal.SIGINT)
        assert heard == [True]
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_ctrl_c_while_one_is_started_is_not_lost():
    heard: list[bool] = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(True))
    try:
        with subprocesses.sigint_blocked():
            os.kill(os.getpid(), signal.SIGINT)  # another thread may hear it at once
        assert heard == [True]
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_process_started_from_a_thread_survives_ctrl_c_too():
    found: list[tuple[int, int]] = []
    thread = threading.Thread(target=lambda: found.append(process_ids()))
    thread.start()
    thread.join(60.0)
    assert len(found) == 1


@on_linux
def test_when_the_server_is_killed_all_end_and_the_next_start_makes_another():
    ours, theirs = subprocesses.CONTEXT.Pipe()
    subprocesses.start(stuck, theirs)
    theirs.close()
    pid, server = ours.recv()
    assert server != os.getpid()
    os.kill(server, signal.SIGKILL)
    _, other = process_ids()
    assert other not in (server, os.getpid())
    assert gone(pid)


def test_where_none_can_be_started_there_is_one_sentence(monkeypatch):
    def refused(_self: object) -> None:
        raise EOFError("unexpected EOF")

    monkeypatch.setattr(subprocesses.CONTEXT.Process, "start", refused)
    with pytest.raises(ConfigError, match="no child process could be started: look"):
        subprocesses.start(report, None)


@on_linux
def test_stuck_ones_end_with_their_parent_and_nothing_comes_from_the_working_folder(tmp_path):
    program, here = tmp_path / "program", tmp_path / "here"
    program.mkdir()
    here.mkdir()
    for library in ("random", "numpy", "league"):
        (here / f"{library}.py").write_text("raise OSError('not the library')")
    (program / "endless.py").write_text(
        textwrap.dedent(
            """
            import os, signal, sys, time
            from league import subprocesses

            def stuck(pipe):
                pipe.send((os.getpid(), os.getppid(), "league.racing.race" in sys.modules))
                while True:
                    time.sleep(1.0)

            if __name__ == "__main__":
                subprocesses.prepare(["league.racing.race"])
                ours, theirs = subprocesses.CONTEXT.Pipe()
                subprocesses.start(stuck, theirs)
                print(*ours.recv(), flush=True)
                os.kill(os.getpid(), signal.SIGKILL)
            """
        )
    )
    killed = subprocess.Popen(
        [sys.executable, str(program / "endless.py")], cwd=here, stdout=subprocess.PIPE, text=True
    )
    output, _ = killed.communicate(timeout=60.0)
    assert killed.returncode == -signal.SIGKILL
    pid, server, loaded = output.split()
    assert loaded == "True"
    assert gone(int(pid)) and gone(int(server))


KILLER = """
import os, signal, threading, time
from multiprocessing import forkserver
from league import subprocesses

def kill_servers(count):
    killed = set()
    while len(killed) < count:
        pid = forkserver._forkserver._forkserver_pid
        if pid and pid not in killed:
            time.sleep(0.01)  # before it can have forked anything
            os.kill(pid, signal.SIGKILL)
            killed.add(pid)
        time.sleep(0.005)

threading.Thread(target=kill_servers, args=(3,), daemon=True).start()
process = subprocesses.start(print, "started")
process.join()
"""
"""Start a process while the server is killed three times as it starts."""


@on_linux
def test_a_server_killed_while_it_starts_is_started_again():
    command = [sys.executable, "-c", KILLER]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ran.stdout == "started\n", ran.stderr
