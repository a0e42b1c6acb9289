"""The bill of materials says what the package is made of, and unsupported systems are refused with a message."""

import importlib.util
import json
import re
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import msgspec
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.running import ran
from tests.sure import known

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / ".ci" / "sbom.py"
SETS = ("requirements", "requirements-test", "requirements-all")


class Hash(msgspec.Struct, forbid_unknown_fields=True):
    """A hash as CycloneDX 1.6 has it; like `Bom` below, only the parts that we write."""

    alg: Literal["SHA-256"]
    content: str


class Name(msgspec.Struct, forbid_unknown_fields=True):
    name: str


class Licence(msgspec.Struct, forbid_unknown_fields=True):
    license: Name | None = None
    expression: str | None = None


class Component(msgspec.Struct, forbid_unknown_fields=True):
    type: Literal["library"]
    bom_ref: str = msgspec.field(name="bom-ref")
    name: str
    version: str
    scope: Literal["required", "excluded"]
    hashes: list[Hash]
    purl: str
    licenses: list[Licence] = []


class Application(msgspec.Struct, forbid_unknown_fields=True):
    type: Literal["application"]
    bom_ref: str = msgspec.field(name="bom-ref")
    name: str
    version: str
    description: str
    licenses: list[Licence]
    purl: str


class Property(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    value: str


class Metadata(msgspec.Struct, forbid_unknown_fields=True):
    component: Application
    properties: list[Property]


class Dependency(msgspec.Struct, forbid_unknown_fields=True):
    ref: str
    dependsOn: list[str]


class Bom(msgspec.Struct, forbid_unknown_fields=True):
    schema: Literal["http://cyclonedx.org/schema/bom-1.6.schema.json"] = msgspec.field(name="$schema")
    bomFormat: Literal["CycloneDX"]
    specVersion: Literal["1.6"]
    serialNumber: str
    version: Literal[1]
    metadata: Metadata
    components: list[Component]
    dependencies: list[Dependency]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = known(importlib.util.spec_from_file_location("sbom", SCRIPT))
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def bom(tmp_path_factory: pytest.TempPathFactory) -> tuple[Bom, bytes]:
    out = tmp_path_factory.mktemp("sbom") / "new" / "bom.json"
    done = ran([sys.executable, str(SCRIPT), str(out)])
    assert (done.returncode, done.stderr) == (0, "")
    data = out.read_bytes()
    return msgspec.json.decode(data, type=Bom), data


def test_the_bill_of_materials_is_cyclonedx_and_refers_to_what_it_holds(bom: tuple[Bom, bytes]) -> None:
    found, _ = bom
    references = {found.metadata.component.bom_ref, *(one.bom_ref for one in found.components)}
    assert len(references) == 1 + len(found.components)
    assert {one.ref for one in found.dependencies} == references
    assert {name for one in found.dependencies for name in one.dependsOn} <= references
    assert re.fullmatch(
        r"urn:uuid:[0-9a-f]{8}-[0-9a-f]{4}-5[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}", found.serialNumber
    )
    for one in found.components:
        assert one.purl == one.bom_ref == f"pkg:pypi/{one.name}@{one.version}"
        assert all((licence.license is None) != (licence.expression is None) for licence in one.licenses)


def test_it_names_every_requirement_with_every_hash_that_may_be_installed(bom: tuple[Bom, bytes]) -> None:
    entries: dict[tuple[str, str], set[str]] = {}
    text = "".join((ROOT / f"{name}.txt").read_text("utf-8") for name in SETS[:2])
    for entry in re.split(r"\n(?=[\w-])", text):
        head = re.match(r"([\w.-]+)==([^\s;]+)", entry)
        if head is not None:
            entries[head[1], head[2]] = set(re.findall(r"sha256:([0-9a-f]{64})", entry))
    found = {(one.name, one.version): {each.content for each in one.hashes} for one in bom[0].components}
    assert found.items() <= entries.items()
    assert {name for name, _ in found} == {name for name, _ in entries}
    assert min(map(len, found.values())) >= 1


def test_what_runs_is_told_from_what_tests(bom: tuple[Bom, bytes]) -> None:
    scopes = {one.name: one.scope for one in bom[0].components}
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    named = {re.split(r"[=<>]", one)[0] for one in dependencies}
    assert {scopes[name] for name in named} == {"required"}
    assert {scopes[name] for name in ("pytest", "mypy", "ruff", "hypothesis", "sqlfluff")} == {"excluded"}
    own = next(one for one in bom[0].dependencies if one.ref == bom[0].metadata.component.bom_ref)
    assert {name.removeprefix("pkg:pypi/").partition("@")[0] for name in own.dependsOn} == named


def test_it_is_the_same_each_time(bom: tuple[Bom, bytes], script: ModuleType) -> None:
    again: dict[str, Any] = script.document(ROOT)
    assert json.dumps(again, indent=2, ensure_ascii=False).encode() + b"\n" == bom[1]


@pytest.mark.parametrize(
    "text",
    [
        "msgspec==0.22.0\n",
        "msgspec>=0.22 \\\n    --hash=sha256:" + "0" * 64 + "\n",
        "msgspec==0.22.0 \\\n    --hash=md5:00\n",
    ],
)
def test_a_requirement_that_is_not_pinned_is_found(script: ModuleType, text: str) -> None:
    with pytest.raises(SystemExit, match="expected NAME==VERSION and its hashes"):
        list(script.pinned(text))


def test_an_installation_that_is_not_as_pinned_is_found(script: ModuleType) -> None:
    for name, version, part in (
        ("msgspec", "0.0.1", "expected 0.0.1"),
        ("no-such-package", "1", "found none installed"),
    ):
        with pytest.raises(SystemExit, match=part):
            script.installed(script.Pinned(name, version, ("0" * 64,)))


def test_the_checks_of_a_change_run_the_tests_bare_then_with_all_extras_and_then_the_bill() -> None:
    lines = (ROOT / ".ci" / "run").read_text("utf-8").splitlines()
    assert [line for line in lines if line.startswith("make ")] == ["make test", "make test-rest", "make sbom"]


@pytest.mark.parametrize("name", SETS)
def test_every_version_that_a_set_up_installs_is_pinned_by_hash_in_one_file(script: ModuleType, name: str) -> None:
    own = list(script.pinned((ROOT / f"{name}.txt").read_text("utf-8")))
    wanted = re.findall(r"^([\w-]+)", (ROOT / f"{name}.in").read_text("utf-8"), flags=re.MULTILINE)
    assert {canonicalize_name(one) for one in wanted if not one.startswith("-")} <= {one.name for one in own}


def test_each_set_up_adds_to_the_one_before() -> None:
    first = {name: (ROOT / f"{name}.txt").read_text("utf-8").partition("\n")[0] for name in SETS}
    assert [first[name] for name in SETS[1:]] == [f"-r {before}.txt" for before in SETS[:-1]]
    targets = dict(re.findall(r"^(reproduce|test-all|check|test): (.+)$", (ROOT / "Makefile").read_text("utf-8"), re.M))
    assert targets == {
        "reproduce": "$(READY)",
        "check": "$(READY_TEST)",
        "test": "check",
        "test-all": "$(READY_ALL) check",
    }


def test_what_runs_needs_no_package_of_the_tests(script: ModuleType) -> None:
    """Each dependency of the package, and of these in turn, is in the first file."""
    first = {one.name for one in script.pinned((ROOT / "requirements.txt").read_text("utf-8"))}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    waiting = [canonicalize_name(Requirement(text).name) for text in project["dependencies"]]
    reached: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            parsed = [Requirement(text) for text in distribution(name).requires or []]
            waiting += [
                canonicalize_name(one.name) for one in parsed if not one.marker or one.marker.evaluate({"extra": ""})
            ]
    assert reached <= first


def test_an_unsupported_system_is_refused_with_a_message() -> None:
    code = (
        "import os, sys; sys.argv = ['fsar-ledger', 'info', 'x']; "
        "from fsar_ledger.__main__ import main; os.name = 'nt'; main()"
    )
    done = ran([sys.executable, "-c", code])
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "fsar-ledger: found an operating system that is not POSIX (nt), expected Linux or macOS; on Windows use WSL\n"
    )
