"""Processes beside this one: deaf to Ctrl-C, replaced when they die, gone with their parent."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from league import side_process
from league.errors import ConfigError


def tell(pipe: Connection) -> None:
    """Say who this is, then wait to be asked to end."""
    deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    pipe.send((os.getpid(), os.getppid(), deaf, side_process.orphaned()))
    pipe.recv()


@pytest.fixture(autouse=True)
def prepared() -> None:
    side_process.prepare()


def told() -> tuple[int, int, bool, bool]:
    """Return what a fresh process says of itself, once it has ended."""
    ours, theirs = side_process.CONTEXT.Pipe()
    process = side_process.start(tell, theirs)
    theirs.close()
    answer = ours.recv()
    ours.send("end")
    process.join(10.0)
    assert process.exitcode == 0
    return answer


def alive(pid: int) -> bool:
    try:
        return " Z " not in Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False


def test_a_process_is_deaf_to_ctrl_c_and_knows_its_parent():
    pid, _, deaf, orphaned = told()
    assert pid != os.getpid()
    assert deaf and not orphaned
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    assert not side_process.orphaned()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a server")
def test_a_server_that_was_killed_is_started_again():
    _, server, _, _ = told()
    assert server != os.getpid()
    os.kill(server, signal.SIGKILL)
    _, other, _, _ = told()
    assert other not in (server, os.getpid())


def test_where_none_can_be_started_there_is_one_sentence(monkeypatch):
    def refused(_self: object) -> None:
        raise EOFError("unexpected EOF")

    monkeypatch.setattr(side_process.CONTEXT.Process, "start", refused)
    with pytest.raises(ConfigError, match="no process could be started beside this one: look"):
        side_process.start(tell, None)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_process_ends_with_the_one_that_started_it(tmp_path):
    (tmp_path / "endless.py").write_text(
        textwrap.dedent(
            """
            import os, signal, time
            from league import side_process

            def endless(pipe):
                side_process.end_with_parent()
                pipe.send(os.getpid())
                while True:
                    time.sleep(1.0)

            if __name__ == "__main__":
                ours, theirs = side_process.CONTEXT.Pipe()
                side_process.start(endless, theirs)
                print(ours.recv(), flush=True)
                os.kill(os.getpid(), signal.SIGKILL)
            """
        )
    )
    killed = subprocess.Popen(
        [sys.executable, str(tmp_path / "endless.py")], stdout=subprocess.PIPE, text=True
    )
    assert killed.stdout is not None
    pid = int(killed.stdout.readline())
    assert killed.wait(30.0) == -signal.SIGKILL
    killed.stdout.close()
    give_up = time.monotonic() + 30.0
    while alive(pid) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert not alive(pid)
