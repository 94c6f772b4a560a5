"""The studio reads and writes under its folder, and lets in whom it may."""

import asyncio

import pytest

from designlab.app.studio.access import Guard, is_local, new_token
from designlab.app.studio.confinement import OutsideFolder, files_below, inside, new_file, shown


@pytest.mark.parametrize("name", ["a.toml", "sub/a.toml", "sub/../a.toml", "."])
def test_names_within_the_folder_are_taken(tmp_path, name):
    assert inside(tmp_path, name).is_relative_to(tmp_path)


@pytest.mark.faults
@pytest.mark.parametrize("name", ["../a.toml", "/etc/passwd", "sub/../../a", "a\0b", "..", "link/secret"])
def test_names_that_lead_out_are_refused(tmp_path, name):
    root = tmp_path / "root"
    root.mkdir()
    (root / "link").symlink_to(tmp_path)
    with pytest.raises(OutsideFolder):
        inside(root, name)


@pytest.mark.parametrize("pattern", ["study.toml", "*.toml"])
def test_files_are_listed_two_levels_down_and_not_where_links_lead_out(tmp_path, pattern):
    root = tmp_path / "root"
    for place in ("root/a", "root/b/c", "root/b/c/d", "elsewhere"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "study.toml").touch()
    (root / "link").symlink_to(tmp_path / "elsewhere")
    (root / "a" / "outside.toml").symlink_to(tmp_path / "elsewhere" / "study.toml")
    assert [shown(root, path) for path in files_below(root, pattern)] == ["a/study.toml", "b/c/study.toml"]


@pytest.mark.parametrize("name", ["sensor", "my sensor.toml", "v1.2_b-3"])
def test_a_plain_name_gives_a_file_with_its_suffix(tmp_path, name):
    path = new_file(tmp_path, name, ".toml")
    assert path.parent == tmp_path.resolve()
    assert path.suffix == ".toml"
    assert shown(tmp_path, path) == path.name


@pytest.mark.faults
@pytest.mark.parametrize(
    "name", ["../out", "a/b", "<script>alert(1)</script>", "", ".hidden", "a..b", "x" * 200, "a\nb"]
)
def test_other_names_give_no_file(tmp_path, name):
    with pytest.raises(OutsideFolder):
        new_file(tmp_path, name, ".toml")


class Inner:
    """Stands for the pages."""

    def __init__(self):
        self.asked = []

    async def __call__(self, scope, receive, send):
        self.asked.append(scope["type"])
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})


def answers(guard, *, kind="http", query="", host="127.0.0.1:80", **headers):
    """Status of a request, or the close code of a websocket, and the headers of the answer."""
    sent = []
    told = {"host": host, **headers}
    scope = {
        "type": kind,
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in told.items()],
    }

    async def send(message):
        sent.append(message)

    asyncio.run(guard(scope, None, send))
    first = sent[0] if sent else {}
    return first.get("status", first.get("code", "passed")), dict(first.get("headers", []))


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_with_a_token_only_who_shows_it_comes_in(kind):
    token = new_token()
    inner = Inner()
    guard = Guard(inner, token)
    refused = 403 if kind == "http" else 1008
    assert answers(guard, kind=kind)[0] == refused
    assert answers(guard, kind=kind, query="token=wrong")[0] == refused
    assert answers(guard, kind=kind, cookie="designlab-studio=wrong")[0] == refused
    assert inner.asked == []
    assert answers(guard, kind=kind, query=f"token={token}")[0] in (200, "passed")
    assert answers(guard, kind=kind, cookie=f"designlab-studio={token}")[0] in (200, "passed")


def test_who_shows_the_token_gets_a_cookie_that_scripts_cannot_read():
    token = new_token()
    cookie = answers(Guard(Inner(), token), query=f"token={token}")[1][b"set-cookie"].decode()
    assert token in cookie
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie


@pytest.mark.parametrize("host", ["127.0.0.1:8421", "localhost:1", "[::1]:8421"])
def test_without_a_token_this_machine_is_served(host):
    assert answers(Guard(Inner(), None), host=host)[0] == 200


@pytest.mark.faults
@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:80", "192.168.1.2:8421", ""])
def test_a_name_that_was_made_to_lead_here_is_refused(host):
    assert answers(Guard(Inner(), None), host=host)[0] == 403


@pytest.mark.faults
@pytest.mark.parametrize("length", ["22000001", "1e3", "-5", "99999999999999999999"])
def test_a_request_that_is_too_large_is_refused_unread(length):
    assert answers(Guard(Inner(), None), **{"content-length": length})[0] == 413
    assert answers(Guard(Inner(), None), **{"content-length": "20000000"})[0] == 200


@pytest.mark.faults
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_foreign_page_is_refused(kind):
    found = answers(Guard(Inner(), None), kind=kind, origin="http://evil.example")[0]
    assert found == (403 if kind == "http" else 1008)


def test_tokens_differ_and_local_is_local():
    assert new_token() != new_token()
    assert is_local("127.0.0.1")
    assert not is_local("0.0.0.0")
