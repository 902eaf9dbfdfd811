"""CURVE keys: a viewer with one hears, one without or with another hears nothing, and nobody's commands go that way."""

import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from galen_hw.bus import Subscriber
from galen_hw.cli import main
from galen_hw.config.schema import BusSection
from galen_hw.daemon.viewers import Viewers
from galen_hw.errors import UsageError
from galen_hw.keys import add_key, names, prove, remove_key, secret_of
from tests.daemon_tree import Tree, daemon_tree, within

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this ZeroMQ was built without CURVE")
SILENT_S = 1.5


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    """A daemon whose viewers need keys; `laptop` and, taken away again, `lost` have one."""
    folder = tmp_path_factory.mktemp("keyed")
    (folder / "out").mkdir()
    for name in ("laptop", "lost"):
        add_key(folder / "keys", name, folder / "out")
    remove_key(folder / "keys", "lost")
    with daemon_tree(folder) as tree:
        config = tree.write_config()
        bus = f'viewers = "tcp://127.0.0.1:0"\nkeys = "{folder / "keys"}"'
        config.write_text(config.read_text().replace('viewers = ""', bus))
        tree.start_ready()
        tree.viewers = str(tree.call("daemon", "info")["viewers"])
        yield tree


def key(tree: Tree, name: str) -> tuple[Path, Path]:
    return tree.folder / "out" / f"{name}.key_secret", tree.folder / "keys" / "server.key"


def test_a_viewer_with_a_key_hears(keyed: Tree) -> None:
    with Subscriber(keyed.viewers, ["wrench/compensated"], keys=key(keyed, "laptop")) as viewer:
        assert within(20.0, lambda: viewer.receive(1.0) is not None)


def test_a_viewer_without_or_with_another_key_hears_nothing(keyed: Tree) -> None:
    """No key, a key that was taken away, and a daemon that is another one than the viewer believes."""
    wrong = (key(keyed, "laptop")[0], keyed.folder / "keys" / "clients" / "laptop.key")
    for keys in (None, key(keyed, "lost"), wrong):
        with Subscriber(keyed.viewers, ["wrench/compensated"], keys=keys) as viewer:
            assert viewer.receive(SILENT_S) is None


def test_a_request_over_the_viewers_port_goes_nowhere(keyed: Tree) -> None:
    """With a key or without one: the copy publishes, and takes nothing but wishes for topics."""
    before = keyed.motors.heard
    with zmq.Context.instance().socket(zmq.XSUB) as one:
        one.setsockopt(zmq.LINGER, 0)
        prove(one, *key(keyed, "laptop"))
        one.connect(keyed.viewers)
        one.send(b"\x01wrench/raw")
        one.send_multipart([b"", b"\x84\xa2id\xa11\xa6target\xa6motors\xa4name\xa4stop\xa4args\x80"])
        assert one.poll(20_000)
    assert b"STOP" not in before + keyed.motors.heard
    assert keyed.call("daemon", "info")["ready"]


def test_secrets_are_their_owners_and_a_name_has_one(tmp_path: Path) -> None:
    """No other user may read a secret; a second key of a name is refused; one that others may read is not used."""
    secret = add_key(tmp_path / "keys", "a", tmp_path)
    for path in (secret, tmp_path / "keys" / "server.key_secret"):
        assert not stat.S_IMODE(path.stat().st_mode) & 0o007
    assert names(tmp_path / "keys") == ["a"]
    with pytest.raises(UsageError, match="is there already"):
        add_key(tmp_path / "keys", "a", tmp_path)
    with pytest.raises(UsageError, match="cannot be a viewer's name"):
        add_key(tmp_path / "keys", "../a", tmp_path)
    secret.chmod(0o644)
    with pytest.raises(UsageError, match="others may read it"):
        secret_of(secret)


def test_a_daemon_without_its_own_key_is_refused_in_one_line(tmp_path: Path) -> None:
    from galen_hw.config.paths import Addresses

    with pytest.raises(UsageError, match="cannot be read"):
        Viewers("tcp://127.0.0.1:0", Addresses(tmp_path), 100, tmp_path / "none")


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:9872", "tcp://192.168.1.7:9872"])
def test_other_machines_need_keys(tmp_path: Path, address: str) -> None:
    """Beyond this machine there are no viewers without keys."""
    with pytest.raises(ValueError, match="from this machine only"):
        BusSection(viewers=address)
    assert BusSection(viewers=address, keys=tmp_path).viewers == address


def test_the_command_makes_lists_and_takes_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--keys", str(tmp_path / "keys"), "--out", str(tmp_path)]
    assert main(["keys", "add", "laptop", *words]) == 0
    assert (tmp_path / "laptop.key_secret").exists()
    capsys.readouterr()
    assert main(["keys", "list", *words]) == 0
    assert capsys.readouterr().out == "laptop\n"
    assert main(["keys", "remove", "laptop", *words]) == 0
    assert main(["keys", "remove", "laptop", *words]) == 2
    assert main(["keys", "add", *words]) == 2
    assert "needs a name" in capsys.readouterr().err
