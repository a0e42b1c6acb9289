"""Writes the software bill of materials of a checkout as CycloneDX 1.6 JSON: `python .ci/sbom.py [FILE]`.

Lists each requirement of this interpreter in `requirements.txt` and `requirements-test.txt` with its version, the
SHA-256 of every file that may be installed for it, the licence in its metadata, and what it needs itself. `required` is
what the package needs when it runs, `excluded` what only its tests and checks need. The same checkout and installation
give the same bytes: it holds no time, and its serial number is derived from its contents. The extras of
`requirements-all.txt`, which only execute pages of the documentation, are not in it.
"""

import hashlib
import json
import re
import sys
import tomllib
import uuid
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
FILES = ("requirements.txt", "requirements-test.txt")
LONGEST_NAME = 80  # what is longer is the text of a licence, not its name


class Pinned(NamedTuple):
    """One entry of a requirements file: a version, and the SHA-256 of each file that may be installed for it."""

    name: str
    version: str
    hashes: tuple[str, ...]


def pinned(text: str) -> Iterator[Pinned]:
    """Yield the entries for this interpreter and platform. Raises: SystemExit for one without a version or hashes."""
    for entry in re.split(r"\n(?=\S)", re.sub(r"^(\s*#|-r ).*\n?", "", text, flags=re.MULTILINE).strip()):
        line, *rest = entry.replace("\\\n", "\n").splitlines()
        requirement = Requirement(line)
        hashes = tuple(re.findall(r"--hash=sha256:([0-9a-f]{64})(?!\S)", "\n".join(rest)))
        versions = [one.version for one in requirement.specifier if one.operator == "=="]
        if len(versions) != 1 or not hashes:
            raise SystemExit(
                f"requirements: found {line.strip()!r} with {len(hashes)} hashes, expected NAME==VERSION and its hashes"
            )
        if requirement.marker is None or requirement.marker.evaluate():
            yield Pinned(canonicalize_name(requirement.name), versions[0], hashes)


def installed(one: Pinned) -> Distribution:
    """Return the metadata of this requirement. Raises: SystemExit unless that version is installed."""
    try:
        found = distribution(one.name)
    except PackageNotFoundError:
        raise SystemExit(f"{one.name}: found none installed, expected {one.version}; run make test") from None
    if found.version != one.version:
        raise SystemExit(f"{one.name}: found {found.version} installed, expected {one.version}; run make test")
    return found


def needs(requirements: list[str], known: set[str]) -> list[str]:
    """Return the names of these requirements that apply here, without extras."""
    parsed = [Requirement(text) for text in requirements]
    return sorted(
        {
            name
            for one in parsed
            if (name := canonicalize_name(one.name)) in known
            and (one.marker is None or one.marker.evaluate({"extra": ""}))
        }
    )


def licences(found: Distribution) -> list[dict[str, object]]:
    """Return the licence in the metadata: an SPDX expression, or else names."""
    expressions, classifiers, texts = (
        [str(text) for text in found.metadata.get_all(name) or []]
        for name in ("License-Expression", "Classifier", "License")
    )
    if expressions:
        return [{"expression": expressions[0]}]
    classified = [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License :: ")]
    names = classified or [
        text.strip()
        for text in texts
        if text.strip() not in ("", "UNKNOWN") and "\n" not in text and len(text) <= LONGEST_NAME
    ]
    return [{"license": {"name": name}} for name in sorted(set(names))]


def reference(name: str, version: str) -> str:
    """Return the package URL, which also names the component within the document."""
    return f"pkg:pypi/{name}@{version}"


def document(root: Path) -> dict[str, object]:
    """Return the bill of materials."""
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    version = re.search(r'__version__ = "([^"]+)"', (root / "fsar_ledger" / "__init__.py").read_text("utf-8"))
    text = "".join((root / name).read_text("utf-8") for name in FILES)
    entries = {one.name: one for one in pinned(text)}
    metadata = {name: installed(one) for name, one in entries.items()}
    needed = {name: needs(found.requires or [], set(entries)) for name, found in metadata.items()}
    own = needs(project["dependencies"], set(entries))
    reached: set[str] = set()
    waiting = list(own)
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += needed[name]
    references = {name: reference(name, one.version) for name, one in entries.items()}
    me = reference(project["name"], version[1] if version else "0")
    body: dict[str, object] = {
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": me,
                "name": project["name"],
                "version": version[1] if version else "0",
                "description": project["description"],
                "licenses": [{"expression": project["license"]}],
                "purl": me,
            },
            "properties": [
                {
                    "name": "python",
                    "value": f"{sys.implementation.name} {sys.version_info.major}.{sys.version_info.minor}",
                }
            ],
        },
        "components": [
            _component(one, metadata[name], is_required=name in reached) for name, one in sorted(entries.items())
        ],
        "dependencies": [
            {"ref": me, "dependsOn": [references[name] for name in own]},
            *(
                {"ref": references[name], "dependsOn": [references[other] for other in needed[name]]}
                for name in sorted(entries)
            ),
        ],
    }
    serial = uuid.uuid5(uuid.NAMESPACE_URL, hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest())
    head: dict[str, object] = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
    }
    return {**head, "serialNumber": f"urn:uuid:{serial}", "version": 1, **body}


def _component(one: Pinned, found: Distribution, *, is_required: bool) -> dict[str, object]:
    licensed = licences(found)
    return {
        "type": "library",
        "bom-ref": reference(one.name, one.version),
        "name": one.name,
        "version": one.version,
        "scope": "required" if is_required else "excluded",
        "hashes": [{"alg": "SHA-256", "content": content} for content in sorted(one.hashes)],
        **({"licenses": licensed} if licensed else {}),
        "purl": reference(one.name, one.version),
    }


def main(out: Path) -> None:
    """Write the bill of materials of the checkout that this script is in."""
    found = document(ROOT)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(found, indent=2, ensure_ascii=False) + "\n", "utf-8")
    components = found["components"]
    assert isinstance(components, list)
    required = sum(one["scope"] == "required" for one in components)
    print(f"{out}: {len(components)} components, {required} of them needed when it runs")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dist" / "fsar-ledger.cdx.json")
