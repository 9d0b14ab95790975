"""Submitting and retiring over HTTP: by token, within quotas, checked as on the command line."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterator
from urllib.parse import quote

import pytest
from starlette.testclient import TestClient

from league.matchmaking import submission
from league.matchmaking.store import Quota, Store
from league.web.security import Limit, Limits
from tests.matchmaking.hostile_entries import HOSTILE
from tests.web.small_league import ORIGIN, RULES, new_league
from tests.web.submitting import ENTRIES, SAME, SOUND, packed, secret, served, token


@pytest.fixture
def store(tmp_path) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path / 'league.db'}"
    with new_league(url, anchors=("centerline",), rules=RULES) as store:
        yield store


def sent(client: TestClient, headers, content=SOUND, name: str = "Ann's car"):
    escaped = quote(name.encode("utf-8", "surrogatepass"), safe="")
    return client.post(f"{ENTRIES}?name={escaped}", content=content, headers=headers)


def test_an_upload_is_the_entry_that_league_submit_makes(store, tmp_path):
    with served(store) as client:
        answer = sent(client, token(store))
    assert answer.status_code == 200
    with new_league(f"sqlite:///{tmp_path / 'other.db'}", rules=RULES) as other:
        local = submission.accept(other, SOUND, "Ann's car", "ann")
    entry = store.entry("Ann's car")
    assert (entry.id, entry.card, entry.owner, entry.state) == (
        *(local.id, local.card, "ann"),
        "pending",
    )
    assert store.blobs.get(entry.blob) == SOUND
    assert answer.json() == {
        "number": entry.number, "id": entry.id, "name": entry.name, "owner": "ann",
        "state": "pending", "near_copy_of": "", "downloadable": False,
        "page": f"/drivers/{entry.number}",
    }  # fmt: skip


def test_the_owner_follows_a_new_entry_on_its_page(store):
    with served(store) as client:
        page = client.get(sent(client, token(store)).json()["page"]).text
        assert "First races" in page and "validation heats are not planned yet" in page
        assert "<code>league run</code> plans" in page and "`" not in page
        live = page[page.index("data-live") :]
        assert "· pending ·" in live[: live.index("First races")]  # its state is renewed, too
        assert "data-live" in page and "/static/live.js" in page
        assert "First races" not in client.get("/drivers/1").text  # an anchor
        assert "It first races itself and an anchor" in page
    for state in ("validating", "placement"):
        store.move({store.entry("Ann's car").id: state})
    with served(store) as client:
        page = client.get("/drivers/2").text
    assert "It passed validation" in page and "It first races itself" not in page


@pytest.mark.parametrize(
    ("header", "status"),
    [
        ({}, 401),
        ({"authorization": "Bearer league_" + "x" * 43}, 401),
        ({"authorization": "Basic YTpi"}, 401),
        ({"authorization": "Bearer " + "x" * 10_000}, 401),
    ],
)
def test_without_a_token_nothing_is_taken(store, header, status):
    with served(store) as client:
        answer = sent(client, header)
    assert answer.status_code == status and "league token create" in answer.json()["error"]
    assert answer.headers["www-authenticate"] == "Bearer"
    assert len(store.entries()) == 1


def test_a_token_without_the_scope_is_refused(store):
    with served(store) as client:
        answer = sent(client, token(store, "ann", "worker"))
    assert answer.status_code == 403 and "scope submit" in answer.json()["error"]


def test_a_revoked_token_is_refused(store):
    headers = token(store)
    with served(store) as client:
        assert sent(client, headers).status_code == 200
        store.tokens.revoke("1")
        assert sent(client, headers).status_code == 401


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_uploads_are_refused_in_one_sentence(store, what, capsys):
    with served(store) as client:
        answer = sent(client, token(store), HOSTILE[what])
    assert answer.status_code in (413, 422)
    sentence = answer.json()["error"]
    assert sentence.endswith(".") and "\n" not in sentence and len(sentence) < 800
    assert len(store.entries()) == 1 and "executed" not in capsys.readouterr().out


def test_a_body_that_never_ends_is_refused_when_it_is_too_large(store):
    given = []

    def endless():
        for _ in range(100):
            given.append(1)
            yield b"\0" * (1 << 20)

    with served(store) as client:
        assert sent(client, token(store), endless()).status_code == 413
    assert len(store.entries()) == 1


HOSTILE_NAMES = (
    "", " ", " ann", "ann ", "a" * 101, "a\nb", "a\x00b", "a\x1b[31m", "\u202egnp.exe", "\u200b",
    "a\u200db", "\u3164", "\ufeff", "Аnn", "аdmin", "ｃenterline", "CENTERLINE", "centerlinе",
    "center\u00adline", "\ud800", "ℂenterline", "cent\u0435rline", "\u0301", "a\u2028b",
)  # fmt: skip
ESCAPED_NAMES = (
    "<script>alert(1)</script>", "\"><img src=x onerror=alert(1)>", "{{7*7}}",
    "'; DROP TABLE entries;--", "../../etc/passwd", "%00%0a", "=HYPERLINK(1)",
    "javascript:alert(1)",
)  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_names_that_cannot_be_shown_or_pass_for_another_are_refused(store, name):
    with served(store) as client:
        answer = sent(client, token(store), name=name)
    assert answer.status_code == 422 and answer.json()["error"].endswith(".")
    assert len(store.entries()) == 1


@pytest.mark.parametrize("name", ESCAPED_NAMES)
def test_names_that_look_like_code_are_text(store, name):
    with served(store) as client:
        page = client.get(sent(client, token(store), name=name).json()["page"])
    assert page.status_code == 200
    assert "<script>alert" not in page.text and "<img" not in page.text and ">49<" not in page.text


def test_an_owner_offers_the_weights_over_http(store):
    with served(store) as client:
        headers = token(store)

        def asked(name: str, seed: int, download: str):
            path = f"{ENTRIES}?name={name}&download={download}"
            return client.post(path, content=packed(seed), headers=headers)

        found = [
            asked(f"car {seed}", seed, download).json()["downloadable"]
            for seed, download in enumerate(("true", "false", ""))
        ]
        assert found == [True, False, False]
        page = asked("car 0", 0, "true").json()["page"]
        assert client.get(f"{page}/checkpoint").content == packed(0)
        assert asked("car 1", 1, "true").json()["downloadable"] is False  # the first one decides
        refused = asked("car 3", 3, "yes")
        assert refused.status_code == 422 and "true or false" in refused.json()["error"]
    assert len(store.entries()) == 4


def test_quotas_are_enforced(store):
    with served(store, quota=Quota(entries=1)) as client:
        headers = token(store)
        assert sent(client, headers).status_code == 200
        assert sent(client, headers).status_code == 200  # the same policy is the same entry
        answer = sent(client, headers, packed(1), "another")
        assert answer.status_code == 429 and "may have 1" in answer.json()["error"]
        assert sent(client, token(store, "bob"), packed(1), "another").status_code == 200


def test_retiring_needs_the_owners_token(store):
    with served(store) as client:
        own, admin = token(store), token(store, "root", "admin")
        sent(client, own)

        def retired(headers, entry="Ann's car"):
            body = {"entry": entry, "reason": "slow"}
            return client.post(f"{ENTRIES}/retire", json=body, headers=headers)

        assert retired(token(store, "bob")).status_code == 403
        assert retired({}).status_code == 401
        assert retired(own, "centerline").status_code == 403
        assert store.entry("Ann's car").state == "pending"
        assert retired(own).json() == {"name": "Ann's car", "state": "retired", "changed": True}
        assert retired(own).json()["changed"] is False
        assert (store.entry("Ann's car").state, store.entry("Ann's car").reason) == (
            *("retired", "slow"),
        )
        assert retired(own, "nothing").status_code == 422
        assert retired(admin, "centerline").json()["changed"] is True


def filled(client: TestClient, headers=SAME, **fields: str):
    files = {"file": ("a.safetensors", fields.pop("file", SOUND))}
    return client.post("/submit", data=fields, files=files, headers=headers, follow_redirects=False)


def test_the_form_enters_a_driver_without_javascript(store):
    with served(store) as client:
        page = client.get("/submit")
        assert page.status_code == 200 and 'enctype="multipart/form-data"' in page.text
        assert 'href="/submit"' in client.get("/standings").text
        answer = filled(client, token=secret(store), name="Ann's car")
        entry = store.entry("Ann's car")
        assert (answer.status_code, answer.headers["location"]) == (303, f"/drivers/{entry.number}")
        assert store.blobs.get(entry.blob) == SOUND


def test_the_form_offers_the_weights_if_its_box_is_ticked(store):
    with served(store) as client:
        own = secret(store)
        assert 'name="download"' in client.get("/submit").text
        refused = filled(client, token=own, name="a", file=b"?", download="yes")
        assert " checked>" in refused.text and " checked>" not in client.get("/submit").text
        filled(client, token=own, name="kept", file=packed(1))
        filled(client, token=own, name="offered", download="yes")
    assert [store.entry(name).downloadable for name in ("kept", "offered")] == [False, True]


def test_a_refused_form_keeps_its_input_but_never_the_token(store):
    with served(store) as client:
        token = secret(store)
        answer = filled(client, token=token, name='A "<b>" \u00e9', file=SOUND[:-4])
        assert answer.status_code == 422
        assert 'value="A &#34;&lt;b&gt;&#34; é"' in answer.text
        assert token not in answer.text and "Please choose it again" in answer.text
        assert re.search(r'role="alert">the submission .* is refused', answer.text)
        assert answer.headers["cache-control"] == "no-store"
        assert filled(client, token="league_x", name="Zoë").status_code == 401
        assert 'value="Zoë"' in filled(client, token="league_x", name="Zoë").text
        assert "choose the one" in filled(client, token=token, name="a", file=b"").text
    assert len(store.entries()) == 1


def left(client: TestClient, number: int, headers=SAME, **fields: str):
    parts = {name: (None, value) for name, value in fields.items()}
    path = f"/drivers/{number}/retire"
    return client.post(path, files=parts, headers=headers, follow_redirects=False)


def test_an_owner_retires_a_driver_in_the_browser(store):
    with served(store) as client:
        own = secret(store)
        number = submission.accept(store, SOUND, "Ann's car", "ann").number
        path = f"/drivers/{number}/retire"
        assert f'href="{path}"' in client.get(f"/drivers/{number}").text
        assert "no way back" in client.get(path).text
        assert "keeps its place in the standings, marked as retired" in client.get(path).text
        # A form has no data.
        assert ["page as JSON" in client.get(at).text for at in ("/", path)] == [True, False]
        answer = left(client, number, token=own, reason="too <slow>", sure="yes")
        assert (answer.status_code, answer.headers["location"]) == (303, path)
        entry = store.entry("Ann's car")
        assert (entry.state, entry.reason) == ("retired", "too <slow>")
        page = client.get(path).text  # at once, however old a page may be
        assert "Ann&#39;s car is retired" in page and "too &lt;slow&gt;" in page
        assert "<form" not in page
        assert left(client, number, token=own, sure="yes").status_code == 303  # sent twice


def test_nothing_else_retires_a_driver_in_the_browser(store):
    bob, _ = store.tokens.create("bob", ("submit", "worker"))
    worker, _ = store.tokens.create("ann", ("worker",))
    with served(store) as client:
        own = secret(store)
        number = submission.accept(store, SOUND, "Ann's car", "ann").number
        refused = {
            401: ({"token": "league_x", "sure": "yes"}, SAME),
            403: ({"token": bob, "sure": "yes"}, SAME),
            422: ({"token": own}, SAME),
        }
        for status, (fields, headers) in refused.items():
            answer = left(client, number, headers, reason='A "reason"', **fields)
            assert answer.status_code == status
            (sentence,) = re.findall(r'role="alert">(.+?)</p>', answer.text)
            assert sentence.count(".") == 1 and sentence.endswith(".")
            assert (
                'value="A &#34;reason&#34;"' in answer.text and fields["token"] not in answer.text
            )
        for headers in ({}, {"sec-fetch-site": "cross-site"}, {"origin": "https://evil.example"}):
            assert left(client, number, headers, token=own, sure="yes").status_code == 403
        assert left(client, number, token=worker, sure="yes").status_code == 403
        assert left(client, number, token=own, sure="yes", reason="a\nb").status_code == 422
        assert left(client, number, token=own, sure="yes", reason="a" * 301).status_code == 422
        assert left(client, 1, token=own, sure="yes").status_code == 403  # an anchor
        assert left(client, 99, token=own, sure="yes").status_code == 404
        assert client.get("/drivers/99/retire").status_code == 404
    assert "retired" not in {one.state for one in store.entries()}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"sec-fetch-site": "same-origin"}, 303),
        ({"origin": ORIGIN}, 303),
        ({"sec-fetch-site": "cross-site", "origin": ORIGIN}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"sec-fetch-site": "none"}, 403),
        ({"origin": "https://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({}, 403),
    ],
)
def test_a_form_of_another_site_is_refused(store, headers, status):
    with served(store) as client:
        answer = filled(client, headers, token=secret(store), name="Ann's car")
    assert answer.status_code == status
    assert len(store.entries()) == 1 + (status == 303)


def test_a_script_that_sends_a_form_is_given_the_address_to_go_to(store):
    own = secret(store)
    with served(store) as client:
        answer = filled(client, {**SAME, "hx-request": "true"}, token=own, name="Ann's car")
    number = store.entry("Ann's car").number
    assert (answer.status_code, answer.headers["hx-redirect"]) == (204, f"/drivers/{number}")


def test_ten_thousand_mutated_forms_make_no_internal_error(store):
    from league.web.protected import form_fields

    body = (
        b'--xyz\r\nContent-Disposition: form-data; name="name"\r\n\r\nAnn\r\n'
        b'--xyz\r\nContent-Disposition: form-data; name="file"; filename="a;b\\".pt"\r\n'
        b"Content-Type: application/octet-stream\r\n\r\n\0\r\n--xy\xff\r\n--xyz--\r\n"
    )
    kind = "multipart/form-data; boundary=xyz"
    assert form_fields(kind, body) == {"name": b"Ann", "file": b"\0\r\n--xy\xff"}
    dice = random.Random(5)
    for _ in range(10_000):
        content = bytearray(body)
        for _ in range(dice.choice((1, 2, 8))):
            at = dice.randrange(len(content))
            content[at : at + dice.choice((0, 1, 9))] = dice.randbytes(dice.choice((0, 1, 4)))
        fields = form_fields(kind, bytes(content))
        assert all(isinstance(name, str) for name in fields)


@pytest.mark.parametrize(
    "kind",
    [
        "", "multipart/form-data", "application/x-www-form-urlencoded", "text/plain; boundary=",
        "multipart/form-data; boundary=" + "x" * 71, "a; boundary*0*=x''%ff; boundary*1=y",
        "multipart/form-data; boundary=\"x", "\u00e9; boundary=\u00e9",
    ],
)  # fmt: skip
def test_a_form_of_another_kind_is_refused(store, kind):
    with served(store) as client:
        headers = {**SAME, "content-type": kind.encode("utf-8")}
        answer = client.post("/submit", content=b"--x\r\n\r\n--x--", headers=headers)
    assert answer.status_code in (401, 422)


def test_many_requests_of_one_client_have_to_wait(store):
    limits = Limits(Limit(0.5, 3), Limit(0.5, 2), Limit(1, 1), Limit(1, 1))
    with served(store, limits=limits) as client:
        headers = token(store)
        found = [sent(client, headers, b"").status_code for _ in range(4)]
        assert found == [422, 422, 429, 429]
        answer = sent(client, headers, b"")
        assert 1 <= int(answer.headers["retry-after"]) <= 2
        assert answer.json()["error"].startswith("This is more than")
        assert sent(client, token(store, "bob"), b"").status_code == 422  # owners do not share
        wrong = [sent(client, {"authorization": "Bearer x"}).status_code for _ in range(4)]
        assert wrong == [401, 401, 401, 429]


def test_a_bucket_fills_at_its_rate():
    now_s = [100.0]
    limit = Limit(2.0, 4.0, clock=lambda: now_s[0])
    limit.take("a", 4.0)
    with pytest.raises(Exception, match="try again in 1 s"):
        limit.check("a", 1.0)
    now_s[0] += 0.5  # one more
    limit.check("a", 1.0)
    limit.check("b", 4.0)
    limit.take("a", 11.0)  # what was used may be more than there was
    with pytest.raises(Exception, match="try again in 5 s"):
        limit.check("a", 0.0)
    now_s[0] += 1000.0
    limit.check("a", 4.0)
    with pytest.raises(Exception, match="429"):
        limit.check("a", 4.1)


def test_slow_pages_are_limited_and_fast_ones_are_not(store, monkeypatch):
    from league.web import security

    used_s = iter(range(0, 1000))
    with served(store, limits=Limits(pages=Limit(1e-3, 2.5))) as client:
        monkeypatch.setattr(security, "FREE_S", 1e9)
        assert {client.get("/standings").status_code for _ in range(20)} == {200}
        monkeypatch.setattr(security, "FREE_S", 0.0)
        monkeypatch.setattr(security.time, "thread_time", lambda: next(used_s))  # 1 s each
        found = [client.get("/api/v1/standings") for _ in range(5)]
        assert [answer.status_code for answer in found] == [200, 200, 200, 429, 429]
        assert client.get("/static/style.css").status_code == 200


def test_the_openapi_document_describes_what_needs_a_token(store):
    with served(store) as client:
        document = client.get("/api/v1/openapi.json").json()
    operation = document["paths"][ENTRIES]["post"]
    assert operation["security"] == [{"token": []}]
    assert "application/octet-stream" in operation["requestBody"]["content"]
    assert document["components"]["securitySchemes"]["token"]["scheme"] == "bearer"
    assert json.dumps(document).count("$ref") == json.dumps(document).count("#/components/schemas/")
