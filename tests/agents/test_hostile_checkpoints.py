"""Strangers' files: whatever is wrong with one is reported in one sentence, and nothing is run.

The corpus is made here; the files that torch's own safe mode accepts are among them.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import struct
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from league.agents import checkpoint
from league.agents.checkpoint import Checkpoint
from league.errors import PolicyError
from tests.agents.trained import make_checkpoint

Corpus = dict[str, str]
SENTINEL = "it_ran"


class Gadget:
    """Pickles as a call."""

    def __init__(self, function: Callable, *given: object) -> None:
        self.call = (function, given)

    def __reduce__(self):
        return self.call


def saved(content: object) -> bytes:
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def tensors(made: Checkpoint) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(weight) for name, weight in made.weights.items()}


def packed(made: Checkpoint, *, card: object = None, **weights: object) -> bytes:
    """Return the file of a checkpoint with its card or some weights replaced."""
    named = {name.replace("__", "."): value for name, value in weights.items()}
    given = {**tensors(made), **named}
    return saved({"card": made.text if card is None else card, "weights": given})


def carded(made: Checkpoint, **changes: object) -> bytes:
    return packed(made, card=json.dumps({**json.loads(made.text), **changes}))


def rezipped(
    content: bytes,
    rename: dict[str, str] | None = None,
    *,
    replace: dict[str, bytes] | None = None,
    add: tuple[tuple[str, bytes], ...] = (),
    how: int = zipfile.ZIP_STORED,
) -> bytes:
    """Return a copy of the archive with other names, contents or members."""
    rename, replace, buffer = rename or {}, replace or {}, io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(io.BytesIO(content)) as old:
        warnings.simplefilter("ignore")  # about duplicate names
        with zipfile.ZipFile(buffer, "w", how) as new:
            for name in old.namelist():
                inside = name.split("/", 1)[1]
                new.writestr(rename.get(inside, name), replace.get(inside, old.read(name)))
            for name, value in add:
                new.writestr(name, value)
    return buffer.getvalue()


def overlapping(content: bytes) -> bytes:
    """Return the archive with the directory's second number pointing at the first."""
    found = [match.start() for match in re.finditer(rb"PK\x01\x02", content)]
    names = {content[at + 46 : at + 46 + struct.unpack_from("<H", content, at + 28)[0]]: at
             for at in found}  # fmt: skip
    one, two = names[b"archive/data/0"], names[b"archive/data/1"]
    changed = bytearray(content)
    changed[two : two + 46] = content[one : one + 46]
    return bytes(changed)


def crowded() -> bytes:
    """Return a directory that says it lists 60,000 members."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as new:
        for number in range(60_000):
            new.writestr(f"archive/data/{number}", b"")
    return buffer.getvalue()


def lone_tensors() -> dict[str, torch.Tensor]:
    """Return tensors that torch's safe mode loads and that are none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sparse CSR is in beta
        sparse = torch.sparse_csr_tensor(
            torch.tensor([0, 1, 2]), torch.tensor([0, 1]), torch.ones(2), (2, 2)
        )
        torch.Tensor.ccol_indices  # noqa: B018
        sparse.col_indices()[:] = 10**6  # beyond the matrix: invariants are not checked
    return {"meta": torch.zeros(10**6, 10**6, device="meta"), "sparse": sparse}


def corpus(folder: Path) -> Corpus:
    """Write the files; return what the sentence about each must say."""
    made = make_checkpoint("blind")
    sane, sentinel = packed(made), folder / SENTINEL
    odd, expected = lone_tensors(), {}
    head = "mlp.2.bias"
    wide = torch.zeros(1).expand(10**6, 10**6)

    def write(name: str, content: bytes, reason: str) -> None:
        (folder / f"{name}.pt").write_bytes(content)
        expected[f"{name}.pt"] = reason

    def weight(name: str, value: object, reason: str) -> None:
        write(name, packed(made, **{head.replace(".", "__"): value}), reason)

    weight("gadget_system", Gadget(os.system, f"touch {sentinel}"), r"system.*runs nothing")
    weight("gadget_print", Gadget(print, "it ran"), r"print.*runs nothing")
    weight("gadget_eval", Gadget(eval, f"open({str(sentinel)!r}, 'w')"), r"eval.*runs nothing")
    weight("gadget_open", Gadget(open, str(sentinel), "w"), r"open.*runs nothing")
    weight("stride_0_trillion", wide, r"shape \(1000000, 1000000\)")
    weight("stride_0", torch.zeros(1).expand(2), "do not lie one after the other")
    weight("meta", odd["meta"], r"meta.*runs nothing")
    weight("sparse", odd["sparse"], r"sparse.*runs nothing")
    weight("view", torch.zeros(1000)[:2], "do not lie one after the other")
    weight("offset", torch.zeros(3)[1:], "do not lie one after the other")
    weight("gradient", torch.nn.Parameter(torch.zeros(2)), r"parameter.*runs nothing")
    weight("nan", torch.tensor([0.0, float("nan")]), "NaN")
    weight("infinite", torch.tensor([0.0, float("inf")]), "beyond 10000")
    weight("huge_number", torch.tensor([0.0, -1.1e4]), "beyond 10000")
    weight("float64", torch.zeros(2, dtype=torch.float64), "DoubleStorage: all must be float32")
    weight("whole_numbers", torch.zeros(2, dtype=torch.int64), "LongStorage")
    weight("half", torch.zeros(2, dtype=torch.bfloat16), "BFloat16Storage")
    weight("shape", torch.zeros(3), r"shape \(3,\), its card asks \(2,\)")
    weight("text_weight", "zeros", "is no tensor")
    shared = torch.zeros(128, 2)
    aliased = {"mlp__2__weight": shared.view(2, 128), "mlp__0__bias": shared.flatten()[:128]}
    write("aliased", packed(made, **aliased), "do not lie|share their numbers")
    write("extra_name", packed(made, backdoor=torch.zeros(1)), "has the weight 'backdoor'")
    few = {name: value for name, value in tensors(made).items() if name != head}
    write("lacking", saved({"card": made.text, "weights": few}), "lacks the weight 'mlp.2.bias'")
    write("numbered", packed(made, **{"7": torch.zeros(1)}), "has the weight '7'")

    write("deflated", rezipped(sane, how=zipfile.ZIP_DEFLATED), "compressed")
    bomb = (("archive/data/99", bytes(1 << 26)),)
    write("bomb", rezipped(sane, add=bomb, how=zipfile.ZIP_DEFLATED), "compressed")
    write("traversing", rezipped(sane, {"data/0": "../../../etc/cron"}), "no checkpoint does")
    write("absolute", rezipped(sane, {"data/0": "/etc/cron.d/0"}), "no checkpoint does")
    write("dots", rezipped(sane, {"data/0": "../data/0"}), "one folder")
    write("twice", rezipped(sane, add=(("archive/data/0", b"\0" * 8),)), "data/0 twice")
    code = (("archive/code/__torch__.py", b"class Net: pass"),)
    write("torchscript", rezipped(sane, add=code), "no checkpoint does")
    write("unused", rezipped(sane, add=(("archive/data/77", b"\0" * 8),)), "no weight uses")
    write("swapped", rezipped(sane, replace={"byteorder": b"big"}), "other way round")
    write("short_numbers", rezipped(sane, replace={"data/0": b"\0" * 4}), "has 4 bytes")
    write("overlapping", overlapping(sane), "twice|overlap|not what the directory says")
    write("crowded", crowded(), "60000 members")
    damaged = bytearray(sane)
    damaged[sane.index(b"PK\x03\x04", 8) - 40] ^= 1
    write("bit_flip", bytes(damaged), "check sum|damaged|differ|not what")
    many_ops = b"\x80\x02" + b"}" * 30_000 + b"."
    write("many_opcodes", rezipped(sane, replace={"data.pkl": many_ops}), "opcodes")
    unmarked = b"\x80\x02t."  # a tuple of all since a mark that was never set
    write("unmarked", rezipped(sane, replace={"data.pkl": unmarked}), "head is damaged")
    reduced = b"\x80\x04\x95"
    write("protocol_4", rezipped(sane, replace={"data.pkl": reduced}), "protocol 2")
    big_head = b"\x80\x02" + bytes(2 << 20)
    write("huge_head", rezipped(sane, replace={"data.pkl": big_head}), "head takes")

    write("huge_card", carded(made, command="c" * 70_000), "longer than 65536")
    deep = "[" * 30_000 + "]" * 30_000
    write("deep_card", packed(made, card=deep), "nested too deep|no JSON")
    write("card_no_json", packed(made, card="rookie"), "no JSON")
    write("card_list", packed(made, card="[1, 2]"), "format None")
    write("card_tensor", packed(made, card=torch.zeros(2)), "a card and weights")
    write("card_key", carded(made, run="rm -rf"), "run is 'rm -rf'")
    write("card_type", carded(made, steps="many"), "steps is 'many'")
    write("card_number", packed(made, card='{"format": ' + "9" * 5000 + "}"), "no JSON")
    write("later_format", carded(made, format=2), "format 2, this version reads 1")
    large = {"hidden": [1024] * 6}
    write("large_network", carded(made, network=large), "4000000")
    write("layers", carded(made, network={"hidden": [1] * 7}), "1 to 6 layers")
    costly = {"channels": [256, 1], "kernels": [1, 1], "strides": [1, 8], "hidden": [8]}
    sensors = {"camera": {"width": 640, "height": 480, "eyes": "left"}, "lidar": None}
    write(
        "costly_network",
        carded(made, network=costly, sensors=sensors),
        # 256 at each pixel, one at 80 x 60, 8, and 2 answers
        f"{256 * 640 * 480 + 80 * 60 + 8 + 2} activations.*1000000",
    )
    callable_ = {"activation": "os.system"}
    write("activation", carded(made, network=callable_), "activation is 'os.system'")
    write("list", saved([made.text, tensors(made)]), "opcode")
    write("tuple", saved((made.text, tensors(made))), "a card and weights")
    write("more", saved({"card": made.text, "weights": {}, "optimizer": {}}), "nothing else")

    # Nothing in a file moves the cursor, turns the line round or fills the terminal.
    raw = "k\x1b[31m\u202e"
    write("escape_key", carded(made, **{raw: 1}), r"'k\\x1b\[31m\\u202e' is 1")
    write("escape_value", carded(made, kind="\x1b[2J\nfoo\u0336"), r"kind is '\\x1b\[2J")
    inner = {"results": {raw: "fast"}}
    write("escape_result", carded(made, **inner), r"results.'k\\x1b\[31m\\u202e'")
    write("escape_weight", packed(made, **{"a\x1b[2J\nb\u0336": torch.zeros(1)}), r"'a\\x1b\[2J")
    write("escape_member", rezipped(sane, {"data/0": "a/\x1b[2J\n\u0336"}), r"a/\\x1b\[2J")
    head_of = zipfile.ZipFile(io.BytesIO(sane)).read("archive/data.pkl")
    for name, there, other, reason in (
        ("escape_kind", b"FloatStorage", b"\x1b[31mStorage", r"kind \\x1b\[31mStorage: all"),
        ("escape_global", b"OrderedDict", b"\x1b[31m", r"'collections.\\x1b\[31m'"),
        ("escape_device", b"cpu", "\u202e".encode(), r"device '\\u202e'"),
    ):
        assert there in head_of
        changed = head_of.replace(there, other)
        write(name, rezipped(sane, replace={"data.pkl": changed}), reason)
    many = {"hidden": [1] * 20_000}
    write("long_list", carded(made, network=many), r"hidden are \(1, 1")
    write("wide_letters", carded(made, name="\u3164" * 1000), "at most 80 characters")

    write("empty", b"", "is empty")
    write("text", b"I am no checkpoint\n" * 10, "something else")
    write("cut", sane[: len(sane) // 2], "end is missing")
    write("longer", sane + b"\0", "end is missing")
    buffer = io.BytesIO()
    torch.save({"card": made.text}, buffer, _use_new_zipfile_serialization=False)
    write("old_form", buffer.getvalue(), "something else")
    with (folder / "vast.pt").open("wb") as file:
        file.truncate(1 << 40)
    expected["vast.pt"] = "larger than"
    (folder / "folder.pt").mkdir()
    os.mkfifo(folder / "pipe.pt")
    expected |= {"folder.pt": "no file", "pipe.pt": "no file", "absent.pt": "cannot be read"}
    expected["nul\0.pt"] = "cannot be read"
    return expected


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> tuple[Path, Corpus]:
    folder = tmp_path_factory.mktemp("hostile")
    return folder, corpus(folder)


READER = """
import json, resource, sys
import torch
torch.set_num_threads(1)
from league.agents import checkpoint
from league.errors import PolicyError

folder, names = sys.argv[1], json.loads(sys.argv[2])
checkpoint.load(folder + "/../sane.pt")  # loads what it needs before memory is limited
held = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (held + (200 << 20),) * 2)
answers = {}
for name in names:
    try:
        checkpoint.load(f"{folder}/{name}")
        answers[name] = "accepted"
    except PolicyError as error:
        answers[name] = str(error)
print(json.dumps(answers))
"""


def test_every_hostile_file_is_refused_in_one_sentence_and_little_memory(hostile):
    folder, expected = hostile
    checkpoint.save(folder.parent / "sane.pt", make_checkpoint("blind"))
    command = [sys.executable, "-c", READER, str(folder), json.dumps(list(expected))]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
    answers = json.loads(ran.stdout)
    for name, reason in expected.items():
        assert re.search(reason, answers[name]), f"{name}: {answers[name]}"
        assert name in answers[name] or "nul" in name
        assert " is refused: " in answers[name]
        assert answers[name].isascii() and answers[name].isprintable(), ascii(answers[name])
        assert len(answers[name]) < 500, answers[name]
    assert len(expected) >= 50
    assert not (folder / SENTINEL).exists()


def test_torchs_own_safe_mode_lets_some_of_them_pass(hostile):
    # The reason for reading the file by hand: these come through weights_only=True.
    folder, _ = hostile
    for name in ("stride_0_trillion", "meta", "bomb", "nan"):
        torch.load(folder / f"{name}.pt", weights_only=True)


@pytest.mark.parametrize(
    ("field", "value"),
    [(0, b"PK\x03\x05"), (6, b"\x01\x00"), (8, b"\x08\x00"), (30, b"X")],
    ids=["signature", "flags", "method", "name"],
)
def test_a_member_that_contradicts_the_directory_is_refused(tmp_path, field, value):
    content = bytearray(packed(make_checkpoint("blind")))
    second = content.index(b"PK\x03\x04", 4)
    (tmp_path / "sane.pt").write_bytes(content)
    checkpoint.load(tmp_path / "sane.pt")
    content[second + field : second + field + len(value)] = value
    (tmp_path / "changed.pt").write_bytes(content)
    with pytest.raises(PolicyError, match="a member is not what the directory says"):
        checkpoint.load(tmp_path / "changed.pt")


def test_gadgets_would_run_if_they_were_unpickled(hostile, tmp_path):
    # So that the corpus is known to bite.
    folder, _ = hostile
    torch.load(folder / "gadget_open.pt", weights_only=False)["weights"]["mlp.2.bias"].close()
    assert (folder / SENTINEL).exists()
    (folder / SENTINEL).unlink()


def mutated(content: bytes, draw: random.Random) -> bytes:
    """Return the content with some bytes changed, cut, doubled or swapped."""
    changed = bytearray(content)
    for _ in range(draw.choice([1, 1, 2, 5, 20])):
        at = draw.randrange(len(changed))
        size = draw.randrange(1, 40)
        match draw.randrange(6):
            case 0:
                changed[at] ^= 1 << draw.randrange(8)
            case 1:
                changed[at] = draw.randrange(256)
            case 2:
                del changed[at : at + size]
            case 3:
                changed[at:at] = changed[at : at + size]
            case 4:
                changed[at : at + size] = draw.randbytes(size)
            case 5:
                del changed[at:]
        if not changed:
            return b"\0"
    return bytes(changed)


@pytest.mark.parametrize("where", ["file", "head", "card"])
def test_damaged_files_are_read_or_refused_and_nothing_else(tmp_path, where):
    made, path = make_checkpoint("blind"), tmp_path / "a.pt"
    sane, draw = packed(made), random.Random(where)
    head = zipfile.ZipFile(io.BytesIO(sane)).read("archive/data.pkl")
    read = 0
    for _ in range(int(os.environ.get("LEAGUE_FUZZ", "150"))):
        if where == "file":
            content = mutated(sane, draw)
        elif where == "head":  # with sound check sums, so that the mutation is looked at
            content = rezipped(sane, replace={"data.pkl": mutated(head, draw)})
        else:
            spoilt = mutated(made.text.encode("ascii"), draw).decode("latin-1")
            content = packed(made, card=spoilt)
        path.write_bytes(content)
        try:
            found = checkpoint.load(path)
        except PolicyError as refusal:
            assert str(refusal).isascii() and str(refusal).isprintable()
        else:
            read += 1
            assert found.weights.keys() == made.weights.keys()
    if where == "card":
        assert read > 0  # a changed letter of the name is no harm
