"""Submitting a policy: packed on its owner's machine, checked on the league's; never a pickle.

An entry is a safetensors file: its header's one metadata key holds the checkpoint's card, its
tensors are the actor's weights. Nothing in it is executed.
"""

import hashlib
import json
import os
import struct
import time

import numpy as np

from league.agents import checkpoint
from league.agents.checkpoint import MAX_SIZE_CAMERA, Card, Checkpoint
from league.agents.policy import Policy
from league.agents.torch_archive import RefusedError
from league.errors import LeagueError, PolicyError, brief
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import LeagueEntry, Quota, Store
from league.sim.config import CameraConfig, LidarConfig, SensorConfig, SimConfig

MAX_HEADER = 64 << 10  # bytes of the header, which holds the card and the tensors' places
PROBE_S = 0.025  # time a decision may take on one core [s]; a car decides every 67 ms
DRIVING = {"sensors", "action_space", "network"}
"""Fields of a card that a policy's driving depends on."""
SKETCH = 64  # numbers of a sketch, which estimates distances to about 10 %
NEAR_COPY = 0.01
"""Weights this near to those of another entry, relative to their norm, are labelled a near-copy."""
MAX_PICTURE = 160 * 120  # pixels of each eye under stock sensors


def pack(given: Checkpoint) -> bytes:
    """Return a checkpoint as an entry, always the same bytes; a PolicyError if its card is long."""
    from safetensors.numpy import save

    content = save(dict(given.weights), {"card": given.text})
    (size,) = struct.unpack("<Q", content[:8])
    if size > MAX_HEADER:
        raise PolicyError(
            f"the card of {given.card.name!r} makes a header of {size} bytes: shorten it, at most "
            f"{MAX_HEADER} are allowed"
        )
    return content


def unpack(content: bytes, what: str = "the submission") -> Checkpoint:
    """Return the checkpoint in a stranger's entry; a PolicyError if any part is not sound."""
    from safetensors import SafetensorError, deserialize

    with checkpoint.refusing(what, "submit a checkpoint with `league submit FILE.pt`"):
        if len(content) > MAX_SIZE_CAMERA:
            raise RefusedError(
                f"it takes {len(content)} bytes, at most {MAX_SIZE_CAMERA} are allowed"
            )
        if len(content) < 10:
            raise RefusedError("it is too short to hold a header")
        (size,) = struct.unpack("<Q", content[:8])
        if size > MAX_HEADER:
            raise RefusedError(f"its header claims {size} bytes, at most {MAX_HEADER} are allowed")
        try:
            tensors = dict(deserialize(content))
        except SafetensorError as error:
            raise RefusedError(f"it is no sound safetensors file ({error})") from error
        match json.loads(content[8 : 8 + size]).get("__metadata__"):
            case {"card": str(text), **rest} if not rest:
                card, canonical = checkpoint.read_card(text, len(content))
            case _:
                raise RefusedError("its metadata is not a card, and nothing else")
        for name, tensor in tensors.items():
            if tensor["dtype"] != "F32":
                raise RefusedError(f"the weight {name!r} has dtype {tensor['dtype']}, expected F32")
        checkpoint.check_shapes(card, {name: tuple(one["shape"]) for name, one in tensors.items()})
        weights = {
            name: np.frombuffer(tensor["data"], "<f4").astype(np.float32).reshape(tensor["shape"])
            for name, tensor in tensors.items()
        }
        checkpoint.check_weights(card, weights)
        return Checkpoint(card, weights, canonical)


def probe(given: Checkpoint, what: str = "the submission") -> float:
    """Let a policy decide in made-up situations: finite, the same twice, and fast enough.

    Returns the time of its fastest decision [s of one core], or raises a PolicyError.
    """
    policy = Policy(given, SimConfig().car)
    fastest = float("inf")
    for situation in _situations(given.card):
        # The processor's time of all threads: a busy machine must not refuse a policy.
        start = time.process_time()
        first = policy.outputs(situation)
        fastest = min(fastest, time.process_time() - start)
        again = policy.outputs(situation)
        if not np.isfinite(first).all():
            raise PolicyError(
                f"{what} is refused: its network answers NaN or infinity; train it with smaller "
                "weights"
            )
        if not np.array_equal(first, again):
            raise PolicyError(
                f"{what} is refused: its network answers differently to the same question; "
                "report this, it should not be possible"
            )
    if fastest > PROBE_S:
        raise PolicyError(
            f"{what} is refused: a decision takes {1e3 * fastest:.0f} ms on one core, at most "
            f"{1e3 * PROBE_S:.0f} ms are allowed; make its network or its pictures smaller"
        )
    return fastest


def _situations(card: Card) -> list[dict[str, np.ndarray]]:
    """Return rows a car could observe: all dark, all bright, and seeded noise."""
    generator = np.random.default_rng(20)
    found = []
    for level in (0.0, 1.0, None, None, None, None):
        groups = {}
        for name, shape in card.group_shapes.items():
            noise = generator.random((1, *shape), np.float32)
            row = noise if level is None else np.full_like(noise, level)
            picture = len(shape) == 3
            groups[name] = (255 * row).astype(np.uint8) if picture else 4.0 * row - 2.0
        found.append(groups)
    return found


def check_sensors(sensors: SensorConfig, ruleset: Ruleset) -> None:
    """Refuse sensors (PolicyError) with a mount, lens, rate or scan that is not stock."""
    if sensors.privileged:
        raise PolicyError(
            "this policy is given the true state, which no car can measure: "
            "submit one with cameras or a lidar"
        )
    if ruleset.sensors == "any":
        return
    camera, stock_camera = sensors.camera, CameraConfig()
    for what, given, stock, free in (
        ("camera", camera, stock_camera, ("width", "height", "colour", "eyes")),
        ("lidar", sensors.lidar, LidarConfig(), ("form", "sectors", "bins", "clip")),
    ):
        for name in vars(stock) if given is not None else ():
            if name not in free and getattr(given, name) != getattr(stock, name):
                raise PolicyError(
                    f"its {what} has {name} {brief(getattr(given, name))}, this league's cars "
                    f"carry {brief(getattr(stock, name))}: train with the stock sensors, or race "
                    "where sensors are free (`league init --sensors any`)"
                )
    if camera is not None and camera.width * camera.height > MAX_PICTURE:
        raise PolicyError(
            f"its pictures are {camera.width}x{camera.height}, this league's cameras have at "
            f"most {stock_camera.width}x{stock_camera.height} pixels: train with smaller ones"
        )


def identity(policy: Checkpoint) -> str:
    """Return the id of a policy as an entry: the hash of whatever its driving depends on.

    That is its weights, sensors, action space and network. Neither the rest of its card (name,
    results, command, ...) nor how its file is laid out makes it another entry.
    """
    card = policy.card.model_dump(mode="json", include=DRIVING)
    # Settings that came later do not change the id of a policy that does without them.
    later = {"history": 0, "truth": False, "ahead": False, "frames": 1}
    card["sensors"] = {
        name: value
        for name, value in card["sensors"].items()
        if name not in later or value != later[name]
    }
    content = hashlib.sha256(b"league policy 1\n" + heat_spec.canonical(card))
    for name in sorted(policy.weights):
        weight = policy.weights[name]
        content.update(heat_spec.canonical([name, list(weight.shape)]))
        content.update(np.ascontiguousarray(weight, dtype="<f4").tobytes())
    return content.hexdigest()


def sketch(policy: Checkpoint) -> list[float]:
    """Return a short vector with about the distances of the weights (a count sketch)."""
    weights = np.concatenate([policy.weights[name].ravel() for name in sorted(policy.weights)])
    generator = np.random.default_rng(0)  # the same signs and buckets for every policy
    signs = generator.integers(0, 2, len(weights)) * 2 - 1
    buckets = generator.integers(0, SKETCH, len(weights))
    sums = np.bincount(buckets, signs * weights.astype(float), SKETCH)
    return [float(f"{value:.8g}") for value in sums]


def accept(
    store: Store,
    content: bytes,
    name: str,
    owner: str,
    quota: Quota | None = None,
    *,
    download: bool = False,
) -> LeagueEntry:
    """Check what an owner sent, as `pack` makes it, and enter it; nothing is kept if it is refused.

    With `download` everyone may have its weights. A LeagueError says that it is not sound, that
    its sensors are not stock, that its name is taken, or that the owner's quota is used up.
    """
    what = f"the submission {brief(name)}"
    policy = unpack(content, what)
    check_sensors(policy.card.sensors, store.settings.ruleset)
    probe(policy, what)
    own, vector = identity(policy), sketch(policy)
    driving = policy.card.model_dump(mode="json", include=DRIVING)
    near = ""
    for entry in store.entries():
        if entry.kind != "policy":
            continue
        known, build = entry.card.get("sketch"), entry.card
        if known is None:  # an entry of an older league, which is known by the hash of its file
            try:
                other = unpack(store.blobs.get(entry.blob), f"the entry {brief(entry.name)}")
            except LeagueError:
                continue  # damaged: its own heats fail and say so
            if identity(other) == own:
                own = entry.id
            known, build = sketch(other), other.card.model_dump(mode="json")
        if near or any(build.get(name) != value for name, value in driving.items()):
            continue
        if np.linalg.norm(np.subtract(vector, known)) < NEAR_COPY * np.linalg.norm(known):
            near = entry.name
    card = {**policy.card.model_dump(mode="json"), "digest": policy.digest, "sketch": vector}
    card |= {"near_copy_of": near} if near else {}
    card |= {"download": True} if download else {}
    return store.submit(name, owner, weights=content, card=card, id=own, quota=quota)


def submit(
    store: Store, path: str | os.PathLike[str], name: str, owner: str, *, download: bool = False
) -> LeagueEntry:
    """Submit a checkpoint file: read and packed here, on its owner's machine, then handed in."""
    return accept(store, pack(checkpoint.load(path)), name, owner, download=download)
