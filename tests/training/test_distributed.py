"""Several ranks; started by torchrun, this file is the program of each of them."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch

from league.agents.network import NetworkConfig
from league.errors import ConfigError, LeagueError, RewardError
from league.sim.config import SensorConfig
from league.training.config import PpoConfig, TrainConfig
from league.training.ppo import distributed, make_env
from league.training.ppo.learner import Learner
from league.training.ppo.teacher import TaughtLearner, make_taught

UPDATES = 4


def settings() -> TrainConfig:
    return TrainConfig(
        num_worlds=4,
        seed=3,
        sensors=SensorConfig(),
        network=NetworkConfig(hidden=(16,), normalise=True),
        critic_hidden=(16,),
        ppo=PpoConfig(rollout=8, epochs=1, mini_batches=2),
        episode_s=2.0,
        save_every=2,
    )


def learner() -> Learner:
    tracks = make_env.track_set(make_env.load_tracks(("generated:8",)), both_directions=False)
    return Learner(make_env.make(tracks, settings()), settings())


def with_teacher() -> TaughtLearner:
    """Return a learner with a teacher that has three of four updates."""
    tracks = make_env.track_set(make_env.load_tracks(("generated:8",)), both_directions=False)
    return make_taught(tracks, replace(settings(), teacher=0.6))


def taught(folder: Path) -> dict[str, list[str]]:
    """Return what teacher and policy come to, and what they do if they go on from half the way."""
    made = with_teacher()
    for number in range(UPDATES):
        made.update(number / UPDATES if distributed.is_first() else 0.9)
        if number == 1:
            made.save(folder / f"taught{distributed.number()}.pt", {})
    later = with_teacher()
    later.restore(folder / "taught0.pt")
    for number in (2, 3):
        later.update(number / UPDATES)
    both = {"taught": made, "taught, resumed": later}
    return {name: [digest(one), digest(one.teacher)] for name, one in both.items()}


def digest(made: Learner) -> str:
    """Return a name of all that is learnt, normalisers and the optimiser's memory included."""
    saved, found = made._alg.save(), hashlib.sha256()
    for part in ("actor_state_dict", "critic_state_dict"):
        for value in saved[part].values():
            found.update(value.contiguous().numpy().tobytes())
    found.update(repr(saved["optimizer_state_dict"]).encode())
    found.update(repr(asdict(made._normalization.seen)).encode())
    return found.hexdigest()


def places(made: Learner) -> list[float]:
    return made.env.race_env.world.cars["x"].ravel().tolist()


def rank(folder: Path) -> dict[str, object]:
    """Do what one of two ranks does; return what it has found."""
    made = learner()
    found: dict[str, object] = {
        "count": distributed.count(),
        "agreed": distributed.agreed(distributed.number()),
    }
    found["begun"], found["first places"] = digest(made), places(made)
    found["tracks"] = made.env.race_env.world.track.tolist()
    found["draw"] = float(torch.rand(1))
    for number in range(UPDATES):
        # The ranks have different clocks.
        row = made.update(number / UPDATES if distributed.is_first() else 0.9)
        if number == 1:
            found["places at the save point"] = places(made)
            made.save(folder / f"state{distributed.number()}.pt", {})
    found["rate"], found["samples"] = row.learning_rate, row.samples
    found["learnt"], found["scale"] = digest(made), asdict(made._normalization.seen)
    found["counted"] = int(made._alg.critic.obs_normalizer.count)  # pyright: ignore
    later = learner()
    later.restore(folder / "state0.pt")
    for number in (2, 3):
        later.update(number / UPDATES)
    found["resumed"] = digest(later)
    found |= taught(folder)
    for parameter in made._alg.critic.parameters():
        parameter.grad = torch.full_like(parameter, 1.0 + distributed.number())
    made._alg.reduce_parameters()
    found["gradient"] = {float(p.grad.mean()) for p in made._alg.critic.parameters()}.pop()  # pyright: ignore
    found["stopped"] = [_stopped(signal.SIGINT), _stopped(signal.SIGTERM)]
    if distributed.number() == 1:
        made.env.step = _fails
    try:
        made.update(1.0)
    except LeagueError as error:
        found["failed"] = [type(error).__name__, str(error)]
    found["left"] = time.monotonic()  # of all processes alike
    if distributed.is_first():
        time.sleep(0.3)  # it saves
        found["left"] = time.monotonic()
    distributed.close()
    return found


def _stopped(by: int) -> bool:
    """Return whether this rank stops where it asks, and not before, if the second one is asked."""
    with distributed.interrupted_together() as place:
        place()
        if distributed.number() == 1:
            os.kill(os.getpid(), by)
        try:
            place()
        except KeyboardInterrupt:
            if distributed.is_first():  # as if it had ended: the other one waits for that
                torch.distributed.send(torch.zeros(1), dst=1)
            return True
    return False


def _fails(actions: object) -> tuple:
    raise RewardError("my_reward.py, line 7: division by zero")


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> list[dict]:
    """Return what two ranks have found that learnt together."""
    if "LEAGUE_TORCHRUN" not in os.environ:
        pytest.skip("two processes take 10 to 20 s to start: LEAGUE_TORCHRUN=1 asks for it")
    folder = tmp_path_factory.mktemp("ranks")
    start = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    ran = subprocess.run(
        [sys.executable, *start, __file__, str(folder)],
        env={**os.environ, "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    found = [json.loads((folder / f"rank{number}.json").read_text()) for number in (0, 1)]
    assert not (folder / "state1.pt").exists()  # the first rank alone writes
    return found


def test_ranks_that_torchrun_starts_have_the_same_weights_and_other_worlds(two):
    one, other = two
    assert one["count"] == other["count"] == 2
    assert one["begun"] == other["begun"]
    assert one["learnt"] == other["learnt"] != one["begun"]
    for name in ("first places", "places at the save point", "draw"):
        assert one[name] != other[name], name
    # Four worlds each, of eight tracks.
    assert (one["tracks"], other["tracks"]) == ([0, 1, 2, 3], [4, 5, 6, 7])


def test_gradients_are_the_mean_of_all_ranks(two):
    alone = learner()
    assert digest(alone) == two[0]["begun"]
    for number in range(UPDATES):
        alone.update(number / UPDATES)
    assert digest(alone) != two[0]["learnt"]
    assert [one["gradient"] for one in two] == [1.5, 1.5]  # of 1 and 2


def test_samples_and_running_means_are_of_all_ranks(two):
    for one in two:
        assert one["samples"] == 256  # of 2 ranks, 4 updates, 4 worlds and 8 steps
        assert one["counted"] == 256
        assert one["scale"]["count"] == pytest.approx(256, abs=1e-3)


def test_the_first_rank_decides_how_much_of_the_budget_is_used_up(two):
    first, last = settings().ppo.learning_rate
    # The last update begins with three quarters of it used up by the first rank's clock.
    assert [one["rate"] for one in two] == [pytest.approx(first * (last / first) ** 0.75)] * 2
    assert [one["agreed"] for one in two] == [0, 0]


def test_resumed_ranks_end_as_if_they_had_never_been_interrupted(two):
    for one in two:
        assert one["resumed"] == one["learnt"]


def test_ranks_have_a_tutor_together(two):
    one, other = two
    assert one["taught"] == other["taught"]
    assert one["taught"][0] != one["taught"][1]
    assert one["taught, resumed"] == other["taught, resumed"] == one["taught"]


def test_a_failure_in_one_rank_is_one_in_all_of_them(two):
    said = ["RewardError", "my_reward.py, line 7: division by zero"]
    assert [one["failed"] for one in two] == [said, said]
    # Whoever ends makes torchrun end all others, and the first one saves what was learnt.
    assert two[0]["left"] <= two[1]["left"]


def test_ctrl_c_or_sigterm_in_one_rank_stops_all_at_the_same_place(two):
    assert [one["stopped"] for one in two] == [[True, True], [True, True]]


def test_only_a_rank_that_has_gone_is_reported_as_such():
    with pytest.raises(LeagueError, match="another process of this run"), distributed.exchange():
        raise RuntimeError("[gloo/transport/tcp/pair.cc:538] Connection closed by peer")
    with pytest.raises(RuntimeError, match="size mismatch"), distributed.exchange():
        raise RuntimeError("size mismatch")


def started(monkeypatch, *, rank: int = 0, world: int = 2) -> None:
    """Pretend that torchrun has started this process, on one machine."""
    variables = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": world, "LOCAL_WORLD_SIZE": world}
    for name, value in variables.items():
        monkeypatch.setenv(name, str(value))


def test_without_torchrun_there_is_one_rank_and_nothing_changes(monkeypatch):
    monkeypatch.setenv("RANK", "3")  # what else sets it is none of ours
    assert (distributed.count(), distributed.number(), distributed.is_first()) == (1, 0, True)
    assert distributed.rsl_rl_settings() is None
    assert distributed.device("cuda:1") == "cuda:1"
    assert distributed.seed(42) == 42
    assert distributed.gather((1.0, 2.0)) == [(1.0, 2.0)]
    assert distributed.agreed(True) is True
    distributed.join("cpu")
    assert not torch.distributed.is_initialized()


def test_alone_ctrl_c_is_heard_at_once():
    before = signal.getsignal(signal.SIGINT)
    with distributed.interrupted_together() as place:
        assert signal.getsignal(signal.SIGINT) is before
        place()


def test_each_rank_takes_a_card_and_a_seed_of_its_own(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    found = []
    for number in (0, 1):
        started(monkeypatch, rank=number)
        found.append((distributed.device("cuda"), distributed.device("cpu"), distributed.seed(42)))
    assert [card for card, *_ in found] == ["cuda:0", "cuda:1"]
    assert [cpu for _, cpu, _ in found] == ["cpu", "cpu"]
    seeds = [seed for *_, seed in found]
    assert len({seed & 0xFFFFFFFF for seed in seeds}) == 2  # torch looks at no more of it
    assert all(0 <= seed < 2**62 for seed in seeds)


def test_rsl_rl_gets_its_ranks(monkeypatch):
    started(monkeypatch, rank=1)
    assert distributed.rsl_rl_settings() == {"global_rank": 1, "local_rank": 1, "world_size": 2}
    assert not distributed.is_first()


@pytest.mark.parametrize("number", [0, 1])
def test_more_ranks_than_cards_are_refused_by_all_of_them(monkeypatch, number):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    started(monkeypatch, rank=number)
    with pytest.raises(ConfigError, match="2 processes on this machine, where CUDA finds 1 cards"):
        distributed.device("cuda")


def test_one_card_for_all_ranks_is_refused(monkeypatch):
    started(monkeypatch)
    with pytest.raises(ConfigError, match="the device is 'cuda:0', and torchrun has started 2"):
        distributed.device("cuda:0")


def test_ranks_that_nobody_has_started_are_not_waited_for(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    for name in ("RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match=r"cannot find each other.*start them by torchrun"):
        distributed.join("cpu")


@pytest.mark.parametrize("text", ["two", "0", "-1", ""])
def test_a_number_of_ranks_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv("WORLD_SIZE", text)
    with pytest.raises(ConfigError, match=r"WORLD_SIZE is .* in the environment"):
        distributed.count()


if __name__ == "__main__":
    said = rank(Path(sys.argv[1]))
    (Path(sys.argv[1]) / f"rank{os.environ['RANK']}.json").write_text(json.dumps(said))
