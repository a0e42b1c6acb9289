"""The verbs `serve`, `principal new` and `demo`: a live federation behind HTTP."""

import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from ssl import PROTOCOL_TLS_SERVER, SSLContext, SSLError
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Any

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, UsageError, WriteFailed, option
from fsar_ledger.base.memory import temporary_files
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Plain, Screen, interrupted_by_sigterm
from .federate import CONTINUES, CUT, FLEET, ISOLATED, OF, ROBOTS, SETTINGS, federate
from .key import witness_ask
from .names import Names, Place, names_of
from .verbs import Gives, KeyOption, Option, OriginOption, argument, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.runtime.federation import Federation


def require_service() -> None:
    """Require the packages of the extra. Raises: UsageError."""
    missing = [name for name in ("starlette", "uvicorn", "httptools") if find_spec(name) is None]
    if missing:
        raise UsageError(
            f'serve: found no library {missing[0]}, expected it; install it with `pip install "fsar-ledger[service]"`'
        )


def _require_certificate(certificate: Path | None, key: Path | None) -> None:
    """Require that these files, if any, are a certificate and its key without a password. Raises: UsageError."""
    if certificate is None:
        if key is not None:
            raise UsageError(f"{option('certificate_key', key)}: found no certificate for it, expected --certificate")
        return
    try:
        SSLContext(PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:
        named = option("certificate", certificate) + ("" if key is None else f" {option('certificate_key', key)}")
        reason = "found no such PEM" if isinstance(error, SSLError) else error.strerror
        expected = "a certificate and its key in PEM, the key without a password"
        raise UsageError(f"{named}: {reason}, expected {expected}") from error


class ServedFederation(Answer):
    """A federation server; showing the answer serves until SIGTERM or Ctrl-C."""

    def __init__(self, out: Path, run: str, principals: Path, host: str, port: int, rate: int, **given: Any) -> None:
        self._out, self._run, self._principals, self._given = out, run, principals, given
        self._host, self._port, self._rate = host, port, rate

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Show the address once the federation is open, and serve; yields nothing."""
        require_service()
        from fsar_ledger.service import Principals
        from fsar_ledger.service.server import Service
        from fsar_ledger.sources.stored import kept_origin

        def opened(on_commit: Callable[[int, bytes], None]) -> "Federation":
            if not addresses and kept_origin(self._out) is None:
                raise WriteFailed(f"{self._out}: the ledger was removed while it was served; restore it")
            federation = federate(self._out, run=self._run, on_commit=on_commit, **self._given["federation"])
            if addresses:  # it is opened again after each failed write
                self._given["show"](printable.lines(addresses.pop()))
            return federation

        service = Service(self._out, self._run, opened, Principals(self._principals), self._rate, self._viewed)
        certificate, key = self._given["certificate"], self._given["certificate_key"]
        with self._listening() as listener, interrupted_by_sigterm():
            host, port = listener.getsockname()[:2]
            scheme = "http" if certificate is None else "https"
            addresses = [f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"]
            ended = Event()
            witnesses = Thread(target=self._ask_witnesses, args=(ended,), name="witnesses", daemon=True)
            if self._given["policy"] is not None:
                witnesses.start()
            try:
                with suppress(KeyboardInterrupt):
                    service.serve(listener, certificate, key)
            finally:
                ended.set()
        self._given["say"]("ended: every decision that was answered is on disk")
        yield from ()

    def _ask_witnesses(self, ended: Event) -> None:
        """Have the newest checkpoint cosigned at intervals, as `witness ask` does, until the service has ended."""
        from fsar_ledger.ledger.store.paths import beside

        from .files import write_bytes
        from .ledger import open_ledger

        file = beside(self._out, ".cosigned")
        while not ended.wait(self._given["witness_every"]):
            try:
                cosigned = witness_ask(open_ledger(self._out), self._given["policy"])
                write_bytes(file, str(cosigned.note).encode())
            except FsarLedgerError as error:
                self._given["say"](f"witnesses: {error}")

    def _viewed(self) -> str:
        from .ledger import open_ledger

        with temporary_files():
            folder = TemporaryDirectory()
        with folder as name:
            page = Path(name) / "run.html"
            open_ledger(self._out).view(page, run=self._run)
            return page.read_text("utf-8")

    def _listening(self) -> socket.socket:
        try:
            family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
            return socket.create_server((self._host, self._port), family=family, backlog=1024)
        except (OSError, OverflowError) as error:
            raise UsageError(
                f"--host {self._host} --port {self._port}: {error}, expected a free port of this machine"
            ) from error


@verb(
    "serve out/site --principals site.principals --port 8000",
    name="serve",
    takes=(),
    after_interruption=CONTINUES,
)
def serve_federation(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    principals: Annotated[
        Place, Option("--principals", "FILE", "The registered principals, the file that `principal new` made.")
    ],
    *,
    run: str = declare("NAME", "The name of the run; an existing one is continued.", value="live"),
    fleet: str | None = FLEET,
    robots: int | None = ROBOTS,
    settings: Names = SETTINGS,
    origin: OriginOption = None,
    key: KeyOption = None,
    cut: str | None = CUT,
    isolated: str | None = ISOLATED,
    of: Place | None = OF,
    host: str = declare("ADDRESS", "The address to listen on.", value="127.0.0.1"),
    port: int = declare("N", "The port to listen on; 0 takes a free one.", least=0, most=65535, value=0),
    rate: int = declare("N", "How many commands a second each principal may give.", least=1, value=100),
    certificate: Place | None = declare("FILE", "Serve over TLS with this certificate (PEM)."),
    certificate_key: Place | None = declare("FILE", "The key of the certificate.", "in the same file"),
    policy: Place | None = declare("FILE", "Have checkpoints cosigned by the witnesses of this C2SP policy."),
    witness_every: int = declare(
        "SECONDS", "How often they are cosigned; the newest is OUT.cosigned.", least=1, value=60
    ),
    say: Annotated["Callable[..., None]", Gives("say")],
    show: Annotated["Callable[[SafeText], None]", Gives("show")],
) -> ServedFederation:
    """Govern a real fleet over HTTP, until interrupted.

    Prints its address; the page there describes the interface. A command is answered once its decision is on disk. The
    token identifies the caller, who can give commands only in their own name.

    Raises:
        UsageError: A file cannot be read, the run is not live, or the address is taken.
        WriteFailed: A write failed; what is committed stays.
    """
    if policy is not None:
        from fsar_ledger.witness.policy import read_policy

        read_policy(Path(policy))  # so that its errors are reported before anything begins
    settings = names_of(settings) or ()
    founding = {"fleet": fleet, "robots": robots, "settings": settings, "origin": origin, "key": key, "cut": cut}
    founding |= {"isolated": isolated, "of": of}
    files = [None if file is None else Path(file) for file in (certificate, certificate_key)]
    _require_certificate(*files)
    return ServedFederation(
        Path(out),
        run,
        Path(principals),
        host,
        port,
        rate,
        federation=founding,
        certificate=files[0],
        certificate_key=files[1],
        policy=None if policy is None else Path(policy),
        witness_every=witness_every,
        say=say,
        show=show,
    )


def _token_told(file: Place, name: str) -> Answer:
    return Plain(f"{principal_new(file, name)}\n")


@verb(
    "principal new site.principals robot/A1",
    name="principal new",
    takes=(),
    call=_token_told,
)
def principal_new(
    file: Annotated[Place, argument("FILE", "The file of the principals; created if there is none.")],
    name: Annotated[str, argument("NAME", "robot/A1, supervisor/A1, service/NAME or auditor/NAME.")],
) -> str:
    """Register a principal with the service, and return its token, of which only the hash is stored.

    A robot speaks for itself, a supervisor for the robots they supervise, a service brings work, an auditor reads. To
    revoke a token, remove its line from FILE: the service reads the file when it changes.

    Raises:
        UsageError: No principal can have this name, or the file holds something else.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.service import add_principal

    return add_principal(Path(file), name)


class DemoPlayback(Answer):
    """A playback of the stories of the demo; showing the answer plays them."""

    def __init__(self, out: Path, by_hand: bool, step_s: float) -> None:
        self._out, self._by_hand, self._step_s = out, by_hand, step_s

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield a line for each story, once it has ended."""
        from fsar_ledger.service.demo import HUB, HUMAN, TASKS, Demo, play

        demo = Demo(self._out, self._by_hand, self._step_s)
        with interrupted_by_sigterm(), demo, demo.client(HUB) as hub:
            yield printable.lines(f"console: {demo.url}/console", f"token of {HUMAN}: {demo.tokens[HUMAN]}")
            for number, (name, _tasks) in enumerate(TASKS):
                ended = play(hub, number, 3_600 if self._by_hand else 120 * self._step_s)
                yield printable.lines(f"{name}: {', '.join(ended)}")
        yield printable.lines(f"on record: fsar-ledger log {self._out}; fsar-ledger verify {self._out} --replay")


@verb(
    "demo out/demo",
    "demo out/demo --by-hand",
    name="demo",
    takes=(),
    after_interruption="what was recorded stays, its processes have ended, and a new demo needs a new folder",
)
def demo(
    out: Annotated[Place, argument("OUT", "A new folder.")],
    *,
    by_hand: bool = switch("Answer the calls to the fleet's supervisor yourself, in the console."),
    step: float = declare("SECONDS", "How long each action of a robot takes.", value=1.0),
) -> DemoPlayback:
    """Run six stories against a local service, with a process for each robot and supervisor, and record them.

    A door relay, failures that only a person resolves, two robots at one door, one that goes off, one that leaves.
    Prints the address of a web console that shows them as they happen; with --by-hand you answer the calls there.

    Raises:
        UsageError: OUT is there already, or the extra `service` is not installed.
        WriteFailed: A write failed; what is committed stays.
    """
    require_service()
    if Path(out).exists():
        raise UsageError(f"{printable.value(str(out))}: found something, expected a new folder")
    if not 0 < step <= 60:
        raise UsageError(f"{option('step', step)}: expected more than 0 and at most 60 seconds")
    return DemoPlayback(Path(out), by_hand, step)
