"""Write the parts of these pages that are real output, or (--check) say which of them are out of date.

    python docs/write.py            docs/queries.md, docs/event-types.json, the example in docs/ledger-format.md, the
                                    lists in docs/commands.md and docs/python.md, the tables of constants, readings and
                                    mechanisms in docs/model.md, and the output in every ```console block
    python docs/write.py PAGE...    only these of the first six pages, without output of commands, in a second or two
    python docs/write.py --check    exit code 1 and a diff where a page would change in what a reader notices: not in
                                    digests alone, where no command is run; what begins like words after it is not run

In a ```console block, lines after `$ ` (continued after `> `) are commands, run in order in an empty folder a page.
"""

import base64
import difflib
import inspect
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
from typer.main import get_command

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.cli.app import app, run
from fsar_ledger.designs.constants import WORDS, Constants, origins, with_all_groups
from fsar_ledger.events.configuration import MECHANISMS_OF
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_hashed
from fsar_ledger.ledger.rows.schema import CONCERNED, FINGERPRINTS, SCHEMA, STANDS_ALONE, STORED
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage_rows
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.metrics.multiverse import readings
from fsar_ledger.report.printing import flat

DOCS = Path(__file__).resolve().parent
WITH_OUTPUT = "auditors-hour open record-your-fleet live serve exports shards audit-example model recovery replay"
PAGES = (
    DOCS.parent / "README.md",
    *(DOCS / f"{name}.md" for name in WITH_OUTPUT.split()),
)
FORMAT, MODEL = DOCS / "ledger-format.md", DOCS / "model.md"
NEEDS_NO_SHELL = re.compile(
    r"(?P<call>fsar-ledger(?: (?:[\w./:=,-]+|\"[^\"$`\\]*\"))+)"
    r"(?:(?P<code>; echo \"exit code \$\?\")| \| (?P<pipe>.*))?"
)
"""One command of ours whose words are plain or mean themselves in quotes; its exit code or a pipe may follow."""
INTERNAL = {"about_run", "database"}
"""Methods of `Ledger` that only the command line and the report use."""
DIGEST = re.compile(r"(?<![0-9a-zA-Z])(?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{12,64}(?![0-9a-zA-Z])")
FOLDERS = {
    "staging": "Staging: one view for each event type, and the runs",
    "facts": "Facts: what the events mean",
    "metrics": "Metrics: the judging rules",
    "readings": "Readings: relations as they are when the paper is read otherwise",
    "statistics": "Statistics: architectures compared over paired runs",
    "cases": "Cases: the paper's four cases, claim by claim, and the events behind each number",
    "tables": "Tables: the paper's two tables of grades, and what each grade rests on",
}


def with_output(page: str, left: tuple[str, ...] = ()) -> str:
    """Return the page with the present output of every command in it that does not begin so."""
    with tempfile.TemporaryDirectory() as folder:
        return re.sub(
            r"```console\n(.*?)```",
            lambda block: "```console\n" + "".join(answered(block[1], Path(folder), left)) + "```",
            page,
            flags=re.DOTALL,
        )


def answered(block: str, folder: Path, left: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield each command of the block, followed by what it prints, or by what stands there if it begins so."""
    for command, printed in re.findall(r"^(\$ .*\n(?:>(?: .*)?\n)*)((?:(?!\$ ).*\n)*)", block, flags=re.MULTILINE):
        yield command
        text = "\n".join(line[2:] for line in command.splitlines())
        if text.startswith(left):
            yield printed
        elif plain := NEEDS_NO_SHELL.fullmatch(text):
            said, code = called(plain["call"], folder)
            said += f"exit code {code}\n" if plain["code"] else ""
            yield said_in_a_shell(plain["pipe"], folder, said) if plain["pipe"] else said
        else:
            yield said_in_a_shell(text, folder)


def called(text: str, folder: Path) -> tuple[str, int]:
    """Return what a command of ours prints and its exit code, run in this process, which has its libraries loaded."""
    before, cache = Path.cwd(), os.environ.get("XDG_CACHE_HOME", "")
    os.environ["XDG_CACHE_HOME"] = f"{folder}/.cache"  # so that no cache of other ledgers is used
    os.chdir(folder)
    try:
        with redirect_stdout(StringIO()) as said, redirect_stderr(said):
            code = run(shlex.split(text)[1:])
        return said.getvalue(), code
    finally:
        os.chdir(before)
        os.environ["XDG_CACHE_HOME"] = cache  # empty means unset


def said_in_a_shell(text: str, folder: Path, given: str = "") -> str:
    """Return what any other command prints that is given this text, run by a shell."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-c", text],
        cwd=folder,
        input=given,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        env={**os.environ, "PATH": path, "XDG_CACHE_HOME": f"{folder}/.cache"},
    )
    return done.stdout


def queries_page() -> str:
    """Return the page of all queries by folder, from the headers of the files."""
    lines = [
        "# All queries",
        "",
        "`fsar-ledger query NAME LEDGER` answers each; the last part of a name is enough. "
        "In `sql` the last part is the name of a view, or with parameters that of a macro: `FROM denials(run := 1)`.",
        "",
        "Written by `docs/write.py` from the headers of `queries/`. The key tells any two rows apart; a column of it "
        "that ends in `?` may be NULL, which is a value like others there.",
        "",
    ]
    for folder in dict.fromkeys(name.partition("/")[0] for name in library().queries):
        lines += [
            f"## {FOLDERS.get(folder, folder.capitalize())}",
            "",
            "| query | what it yields | one row for each | key |",
            "|---|---|---|---|",
        ]
        lines += [_row(query) for query in library().queries.values() if query.name.startswith(f"{folder}/")]
        lines.append("")
    return "\n".join(lines)


def _row(query: Query) -> str:
    parameters = "".join(f" `{one}`" for one in query.parameters.values())
    header = query.header
    cells = [
        f"`{query.name}`{parameters}",
        header["Title"],
        header["Grain"].removeprefix("one row per "),
        header["Key"],
    ]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def with_commands(page: str) -> str:
    """Return the page with a line for each command: its arguments and the first line of its help."""
    rows = _rows_of_commands(get_command(app), "fsar-ledger")
    return with_section(page, "commands", "\n".join(["", "| command | what it does |", "|---|---|", *rows, "", ""]))


def _rows_of_commands(command: Any, *words: str) -> Iterator[str]:
    for name, one in getattr(command, "commands", {}).items():
        yield from () if one.hidden else _rows_of_commands(one, *words, name)
    if not hasattr(command, "commands"):
        arguments = (one for one in command.params if one.param_type_name == "argument")
        words += tuple(one.metavar if one.required else f"[{one.metavar}]" for one in arguments)
        yield _line(" ".join(words), command.help)


def with_methods(page: str) -> str:
    """Return the page with a line for each method of `Ledger`: its parameters and the first line of its docstring."""
    rows = [
        _line(f"ledger.{name}({', '.join(_parameters(method))})", inspect.getdoc(method))
        for kind in Ledger.__mro__
        for name, method in vars(kind).items()
        if inspect.isfunction(method) and not name.startswith("_") and name not in INTERNAL
    ]
    return with_section(page, "methods", "\n".join(["", "| method | what it does |", "|---|---|", *rows, "", ""]))


def _parameters(method: Callable[..., object]) -> list[str]:
    _, *parameters = inspect.signature(method).parameters.values()
    return [f"**{one.name}" if one.kind is one.VAR_KEYWORD else one.name for one in parameters]


def _line(call: str, text: str | None) -> str:
    return f"| `{call}` | {(text or '').splitlines()[0].partition(' Raises:')[0].removesuffix('.')} |"


def with_section(page: str, name: str, text: str) -> str:
    """Return the page with this text between the marks of the section."""
    return re.sub(
        rf"<!-- {name} -->\n.*<!-- /{name} -->",
        lambda _: f"<!-- {name} -->\n{text}<!-- /{name} -->",
        page,
        flags=re.DOTALL,
    )


def with_constants(page: str) -> str:
    """Return the page with the table of all constants, their values and the sources of these."""
    values = dict(flat("", json.loads(msgspec.json.encode(with_all_groups(Constants())))))
    rows = [f"| `{name}` | {values[name]} | {word} |" for name, word in origins().items()]
    counts = Counter(origins().values())
    lines = [f"- **{word}** ({counts[word]}): {meaning}" for word, meaning in WORDS.items()]
    text = "\n".join(["", *lines, "", "| constant | value | from |", "|---|---|---|", *rows, ""])
    return with_section(page, "constants", f"{text}\n")


def with_readings(page: str) -> str:
    """Return the page with the table of alternative readings: what each answers, and why the paper allows it."""
    rows = [
        f"| `{one.name}` | {one.reading} | {one.question} | {', '.join(one.moves)} "
        f"| `{one.paper.split()[0]}` | {one.why} |"
        for one in readings()
    ]
    head = ["| reading | instead of | question | moves | paper | why the text allows it |", "|---|---|---|---|---|---|"]
    text = "\n".join(["", f"{len(rows)} readings:", "", *head, *rows, ""])
    return with_section(page, "readings", f"{text}\n")


def with_mechanisms(page: str) -> str:
    """Return the page with the table of all mechanisms that can be taken out of an architecture."""
    named = [
        (architecture, name, what) for architecture, names in MECHANISMS_OF.items() for name, what in names.items()
    ]
    rows = [f"| {architecture} | `{name}` | {what} |" for architecture, name, what in named]
    head = ["| of | `--without` | what it is (what stands in its place) |", "|---|---|---|"]
    text = "\n".join(["", f"{len(rows)} mechanisms:", "", *head, *rows, ""])
    return with_section(page, "mechanisms", f"{text}\n")


def with_tables(page: str) -> str:
    """Return the page on the model with its tables of constants, readings and mechanisms."""
    return with_mechanisms(with_readings(with_constants(page)))


def event_types() -> str:
    """Return what a verifier must know of events.

    The fingerprint of each release's columns; the present columns; and for each type its required, optional and limited
    fields, whether it is the only event of its run, and its concern, if it has one.
    """
    columns = {field.name: f"{field.type}{'' if field.nullable else ' not null'}" for field in SCHEMA}
    types = {
        tag: {
            "required": sorted(field.name for field in layout.fields if not field.is_nullable),
            "optional": sorted(field.name for field in layout.fields if field.is_nullable),
            "values": {field.name: sorted(field.values) for field in layout.fields if field.values is not None},
        }
        | ({"alone": True} if tag in STANDS_ALONE else {})
        | ({"concern": CONCERNED[tag]} if tag in CONCERNED else {})
        for tag, layout in sorted(STORED.items())
    }
    texts = [
        ",\n".join(f'  "{name}": {json.dumps(text)}' for name, text in part.items())
        for part in (FINGERPRINTS, columns, types)
    ]
    parts = [f'"{name}": {{\n{text}\n}}' for name, text in zip(("releases", "columns", "types"), texts, strict=True)]
    return "{\n" + ",\n".join(parts) + "\n}\n"


EXAMPLE_ORIGIN = "example.org/tiny"
# RFC 8032, section 7.1, test 1: published, so no secret
EXAMPLE_SECRET = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
EXAMPLE_RUNS = (
    LedgerRun(
        "r1",
        [0, 1_500_000],
        [None, 0],
        [
            TaskArrived(
                task_id="T1",
                robot=Robot("robot/A1"),
                team=1,
                steps=(),
                budget_us=9,
                due_us=-1,
                checkpoints=("T1/1", "T1/2"),
                is_time_critical=True,
            ),
            TaskCompleted("T1"),
        ],
    ),
    LedgerRun("r2", [7], [None], [TaskAbandoned('"\\\t\u2028\N{ROBOT FACE}')]),
)


def format_page(page: str) -> str:
    """Return the page with the present example of a ledger."""
    with tempfile.TemporaryDirectory() as folder:
        text = "".join(example(Path(folder) / "ledger"))
    return with_section(page, "example", text)


def example(path: Path) -> Iterator[str]:
    """Yield the parts of a ledger of two commits, signed with a published key."""
    signer = Signer(EXAMPLE_ORIGIN, EXAMPLE_SECRET)
    with Writer(path, EXAMPLE_ORIGIN, signer) as writer:
        for run in EXAMPLE_RUNS:
            # Staged without a check: no writer accepts the second run's name, which shows how JSON escapes.
            writer.append(stage_rows(path, [run], *encode_hashed([run])))
    rows = [row for table in open_ledger(path).tables() for row in canonical.from_table(table)]
    leaves = [merkle.leaf_hash(row) for row in rows]

    def block(title: str, *lines: str) -> str:
        return f"\n{title}\n\n```\n" + "".join(line.removesuffix("\n") + "\n" for line in lines) + "```\n"

    yield block("The public key:", str(signer.verifier))
    yield block("`ledger.json`:", (path / "ledger.json").read_text())
    yield block(
        "The bytes of the three events, one a line (the third holds U+2028, which some editors show as a line break):",
        *[row.decode() for row in rows],
    )
    yield block("Their leaf hashes, in hex:", *[leaf.hex() for leaf in leaves])
    yield block(
        "The root of the first two, which is the first commit's, and of all three, the second's:",
        *[merkle.root(leaves[:at]).hex() for at in (2, 3)],
    )
    chain = (path / "chain.jsonl").read_text().splitlines()
    yield block("The second commit and its placement, the last two lines of `chain.jsonl`:", *chain[-2:])
    yield block("`checkpoint`:", (path / "checkpoint").read_text())
    proof = merkle.inclusion_proof(open_ledger(path).node(3), 1, 3)
    hashes = [base64.b64encode(each).decode() for each in (rows[1], *proof)]
    checkpoint = (path / "checkpoint").read_text()
    lines = ["c2sp.org/tlog-proof@v1", f"extra {hashes[0]}", "index 1", *hashes[1:], "", checkpoint]
    yield block("A proof that the second event is in the ledger:", *lines)
    yield "\n"


def noticed(text: str) -> str:
    """Return the text as a reader sees it: each digest by the order in which it first appears.

    A digest changes with every event before it and tells nothing by itself; where two are the same, they stay the same.
    """
    order: dict[str, str] = {}
    return DIGEST.sub(lambda found: order.setdefault(found[0], f"digest-{len(order) + 1}"), text)


def exact() -> dict[Path, str]:
    """Return the pages that run no command: who writes a verifier compares each byte of the format's."""
    return {
        DOCS / "queries.md": queries_page(),
        DOCS / "event-types.json": event_types(),
        DOCS / "commands.md": with_commands((DOCS / "commands.md").read_text("utf-8")),
        DOCS / "python.md": with_methods((DOCS / "python.md").read_text("utf-8")),
        FORMAT: format_page(FORMAT.read_text("utf-8")),
    }


def main(arguments: list[str]) -> int:
    """Write all pages, or those named that run no command, or compare them with what they would be."""
    texts = exact()
    quick = texts | {MODEL: with_tables(MODEL.read_text("utf-8"))}
    if arguments and {DOCS / name for name in arguments} <= quick.keys():
        for name in arguments:
            (DOCS / name).write_text(quick[DOCS / name], "utf-8")
        return 0
    if arguments[:1] not in ([], ["--check"]):
        named = ", ".join(page.name for page in quick)
        print(f"docs/write.py: found {shlex.join(arguments)}, expected --check, {named}, or nothing", file=sys.stderr)
        return 2
    pages = {page: with_output(page.read_text("utf-8"), tuple(arguments[1:])) for page in PAGES}
    pages[MODEL] = with_tables(pages[MODEL])
    if not arguments:
        for page, text in (pages | texts).items():
            if not page.exists() or page.read_text("utf-8") != text:
                page.write_text(text, "utf-8")
        return 0
    compared = {page: (noticed(page.read_text("utf-8")), noticed(text)) for page, text in pages.items()}
    compared |= {page: (page.read_text("utf-8") if page.exists() else "", text) for page, text in texts.items()}
    stale = {page: pair for page, pair in compared.items() if pair[0] != pair[1]}
    for page, pair in stale.items():
        old, new = (text.splitlines(keepends=True) for text in pair)
        print("".join(difflib.unified_diff(old, new, page.name, "as it is now")))
    if stale:
        print("run `make docs` to write these pages again")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
