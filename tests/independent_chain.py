"""Follow the chain, the journal and the segments, as docs/ledger-format.md says; imports nothing of the package.

`independent_verifier.py` calls it.
"""

import base64
import hashlib
import json
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import independent_parquet  # type: ignore[import-not-found]
from independent_cuts import Cuts, goes_on_from  # type: ignore[import-not-found]
from independent_tree import Forest, places_between  # type: ignore[import-not-found]
from independent_verifier import (  # type: ignore[import-not-found]
    COUNT,
    ENVELOPE,
    HASH,
    MAX_INTEGER,
    TEXT,
    TEXTS,
    Key,
    Note,
    ProblemError,
    Tree,
    canonical,
    flaw_of,
    from_base64,
    read_file,
    read_json,
    read_note,
    root_of,
    sha256,
)

Row = dict[str, Any]
FOLDERS = {"segments", "staging"}
FILES = {"ledger.json", "chain.jsonl", "journal.jsonl", "sealing.jsonl", "nodes", "index.jsonl", "checkpoint"}
MANIFEST = {"format": '"fsar-ledger"', "origin": TEXT, "version": "2"}
NAMES = rf"\[({TEXT}(,{TEXT})*)?\]"
COMMIT = {"kind": '"commit"', "number": COUNT, "previous_sha256": HASH, "release": TEXT, "rows": COUNT}
COMMIT |= {"tree_size": COUNT, "tree_root": HASH}
OPTIONAL = {"continues": r"\[.+\]", "goes_on": r"\[.+\]", "signature": TEXT}
ADDING = {"index_bytes": r"[1-9]\d*", "index_sha256": HASH}
PLACEMENT = {"kind": '"placement"', "number": COUNT, "previous_sha256": HASH, "release": TEXT, "schema_sha256": HASH}
PLACEMENT |= {"segment_sha256": HASH, "segment_bytes": COUNT, "first": COUNT, "rows": COUNT}
PLACEMENT |= {"frontier": rf"\[({HASH}(,(?!\])|(?=\])))*\]"}
MOST_ROWS, MOST_BYTES, MOST_LINE = 1 << 20, 1 << 27, 1 << 20
BIG = 1 << 32


def read_record(line: bytes) -> Row:
    """Parse a line of the chain or a record of the journal. Raises ValueError unless it is one (section 2)."""
    try:
        found = json.loads(line.decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no JSON: {error}") from error
    if not isinstance(found, dict) or canonical(found) != line or len(line) >= MOST_LINE:
        raise ValueError("no canonical JSON of an object, or too long")
    must = PLACEMENT if found.get("kind") == "placement" else COMMIT
    may = ADDING if must is PLACEMENT else OPTIONAL
    if not must.keys() <= found.keys() or not found.keys() <= must.keys() | may.keys():
        raise ValueError(f"members {sorted(found)}")
    for name, value in found.items():
        if not re.fullmatch((must | may)[name], canonical(value).decode(), re.DOTALL):
            raise ValueError(f"{name} {value!r:.80}")
        if isinstance(value, int) and value > MAX_INTEGER:
            raise ValueError(f"{name} {value}")
    sizes = found.get("segment_bytes", 1), found.get("index_bytes", 1)
    if not 1 <= found["rows"] <= MOST_ROWS or not 1 <= min(sizes) <= max(sizes) <= MOST_BYTES:
        raise ValueError(f"rows {found['rows']}, or too many bytes")
    for run, seq in found.get("continues", []):
        if not isinstance(run, str) or type(seq) is not int or not 0 <= seq <= MAX_INTEGER:
            raise ValueError(f"continues {run!r:.80} {seq!r:.80}")
    if not all(isinstance(run, str) for run in found.get("goes_on", [])):
        raise ValueError("goes_on holds something else than names")
    if "signature" in found and len(from_base64(found["signature"])) != 68:
        raise ValueError("a signature that has not 68 bytes")
    if "frontier" in found and len(found["frontier"]) != (found["first"] + found["rows"]).bit_count():
        raise ValueError(f"{len(found['frontier'])} hashes in frontier")
    return found


class Chain:
    """The records so far (section 2); `placed` are the placements in force, by their first event."""

    def __init__(self, digest: str, types: Row | None):
        self.digest, self.types = digest, types
        self.commits: list[Row] = []
        self.placements: list[Row] = []
        self.added: list[Row] = []
        self.placed: dict[int, Row] = {}
        self.going: set[str] = set()
        self.before = 0  # events that segments held before the last append

    def copy(self) -> "Chain":
        other = Chain(self.digest, self.types)
        other.commits, other.placements, other.added = list(self.commits), list(self.placements), list(self.added)
        other.placed, other.going, other.before = dict(self.placed), set(self.going), self.before
        return other

    @property
    def size(self) -> int:
        return int(self.commits[-1]["tree_size"]) if self.commits else 0

    @property
    def placed_size(self) -> int:
        return max((first + one["rows"] for first, one in self.placed.items()), default=0)

    def add(self, line: bytes, record: Row) -> None:
        """Add the record if nothing speaks against it. Raises ValueError."""
        releases = self.types["releases"] if self.types is not None else None
        if releases is not None and record["release"] not in releases:
            raise ValueError(f"release {record['release']}")
        if record["previous_sha256"] != self.digest:
            raise ValueError(f"previous_sha256 {record['previous_sha256']}, not {self.digest}")
        if record["kind"] == "commit":
            self.add_commit(record)
        else:
            self.add_placement(record, releases)
        self.digest = sha256(line).hex()

    def add_commit(self, record: Row) -> None:
        continued, goes_on = record.get("continues", []), record.get("goes_on", [])
        runs = [run for run, _ in continued]
        if record["number"] != len(self.commits) or record["rows"] != record["tree_size"] - self.size:
            raise ValueError(f"number {record['number']} or rows {record['rows']}")
        if sorted(set(runs)) != runs or not all(seq for _, seq in continued) or not set(runs) <= self.going:
            raise ValueError(f"continues {continued}")
        if sorted(set(goes_on)) != goes_on:
            raise ValueError(f"goes_on {goes_on}")
        self.going = self.going - set(runs) | set(goes_on)
        self.commits.append(record)

    def add_placement(self, record: Row, releases: Row | None) -> None:
        first, end, placed = record["first"], record["first"] + record["rows"], self.placed_size
        if record["number"] != len(self.placements):
            raise ValueError(f"number {record['number']}")
        if releases is not None and releases[record["release"]] != record["schema_sha256"]:
            raise ValueError(f"schema_sha256 {record['schema_sha256']}")
        if first != placed and first not in self.placed:
            raise ValueError(f"first {first}")
        if {first == placed} != {"index_bytes" in record, "index_sha256" in record}:
            raise ValueError("a line of the index, or none")
        root = next((one["tree_root"] for one in self.commits if one["tree_size"] == end), None)
        if root is None or (end < placed and end not in self.placed):
            raise ValueError(f"rows {record['rows']}")
        if root_of([bytes.fromhex(each) for each in record["frontier"]]).hex() != root:
            raise ValueError("frontier")
        self.before = placed
        self.placed = {at: one for at, one in self.placed.items() if not first <= at < end} | {first: record}
        self.placements.append(record)
        self.added += [record] if first == placed else []


class Verifier:
    """The verification of section 8; each step raises ProblemError for the first thing that is wrong."""

    def __init__(self, ledger: Path, key: Key | None = None, anchor: Path | None = None, types: Row | None = None):
        self.ledger, self.key, self.anchor, self.types = ledger, key, anchor, types
        self.tree = Tree()
        self.seqs: dict[str, int] = {}
        self.observed: dict[str, set[str]] = {}
        self.alone: set[str] = set()
        self.cuts = Cuts()
        own = types["types"] if types is not None else {}
        self.concerns = {name: one["concern"] for name, one in own.items() if "concern" in one}
        self.records = {
            f"{tag.partition('.v')[0]}{field}"
            for tag in self.concerns
            for field in ("", *(f".{name}" for name in own[tag]["optional"]))
        }
        self.stand_alone = {name for name, one in own.items() if one.get("alone")}
        self.remarks, self.is_sealed = list[str](), False

    def verify(self) -> tuple[int, str, str, list[str]]:
        """Verify the ledger; return its events, its root, whose signature it has, and what a crash left."""
        self.check_names()
        manifest, digest = read_json(self.ledger / "ledger.json", "ledger.json", MANIFEST)
        self.origin = manifest["origin"]
        chain = self.read_chain(digest)
        chained = len(chain.commits)
        frames = self.read_journal(chain)
        covered = self.covered(chain, len(chain.commits))
        self.is_behind = self.is_sealed or covered < chain.placed_size
        commits = iter(chain.commits)
        for first in sorted(chain.placed):
            placement = chain.placed[first]
            end, own = first + placement["rows"], list[Row]()
            while not own or own[-1]["tree_size"] < end:
                own.append(next(commits))
            where, rows = self.read_segment(placement)
            self.add_rows(where, rows, own)
            self.check_nodes(first, end, chain)
            self.check_runs(where, rows, own)
            self.check_index(first, rows, chain)
        for name, commit, rows in frames:
            self.add_rows(name, rows, [commit])
            self.check_rows(name, rows, commit["number"])
            self.check_runs(name, rows, [commit])
        self.check_strays(chain)
        self.check_sizes(chain)
        notes = [self.note_of(commit) for commit in chain.commits]
        signature = self.check_signatures(notes, chained)
        self.check_anchor(chain)
        if self.is_behind or covered < chain.size:
            self.remarks.append("behind")
        return chain.size, root_of(self.tree.frontier(chain.size)).hex(), signature, self.remarks

    def check_names(self) -> None:
        found = sorted(os.scandir(self.ledger), key=lambda entry: entry.name)
        for entry in found:
            is_right = (
                entry.is_dir(follow_symlinks=False)
                if entry.name in FOLDERS
                else entry.name in FILES and entry.is_file(follow_symlinks=False)
            )
            if not is_right:
                raise ProblemError(entry.name, "something else, a link or an unknown name", f"only {FOLDERS | FILES}")
        for name in sorted({"ledger.json", "segments"} - {entry.name for entry in found}):
            raise ProblemError(name, "nothing", "it to be there")

    def bytes_of(self, name: str) -> bytes:
        try:
            data: bytes = read_file(self.ledger / name, BIG)
            return data
        except FileNotFoundError:
            return b""
        except (OSError, ValueError) as error:
            raise ProblemError(name, error, "a file of the ledger") from error

    def read_chain(self, digest: str) -> Chain:
        """Read the whole appends, and tell a torn end from damage (section 2)."""
        data, whole = self.bytes_of("chain.jsonl"), Chain(digest, self.types)
        ahead, at, end = whole.copy(), 0, 0
        while at < len(data):
            stop, is_read = data.find(b"\n", at), False
            is_hidden = stop < 0 and data.endswith(b"\0")
            try:
                if stop < 0 and not is_hidden:
                    raise ValueError("a line without end")
                stop = len(data) - 1 if is_hidden else stop
                record = read_record(data[at:stop])
                if is_hidden and record["kind"] == "commit":
                    raise ValueError("a line without end")
                is_read = True
                ahead.add(data[at:stop], record)
            except ValueError as error:
                if is_read or any(is_placement(line) and rest for line, rest in later(data[at:])):
                    raise ProblemError("chain.jsonl", error, "a record of the chain", len(ahead.commits)) from error
                break
            at = stop + 1
            if record["kind"] == "placement":
                whole, end = ahead.copy(), at
        if end < len(data):
            self.remarks.append("torn")
        self.remarks += ["hidden"] if data and end == len(data) and data.endswith(b"\0") else []
        return whole

    def read_journal(self, chain: Chain) -> list[tuple[str, Row, list[Row]]]:
        """Read the frames of both files, and add to the chain the commits that it lacks (section 4)."""
        placed = chain.placed_size
        self.known = [one for one in chain.commits if one["tree_size"] > placed]
        self.frames: list[tuple[str, Row, list[Row]]] = []
        self.grown = self.tree_of(chain)
        for name in ("sealing.jsonl", "journal.jsonl"):
            data = self.bytes_of(name).rstrip(b"\0")
            if name == "journal.jsonl":
                data = self.with_hidden(data)
            lines = data.split(b"\n")
            try:
                first = read_record(lines[0])
            except ValueError:
                first = {}
            is_known = first.get("kind") == "commit" and first in chain.commits[first["number"] : first["number"] + 1]
            if is_known and first["tree_size"] <= placed:
                self.is_sealed = True
            else:
                self.read_frames(name, lines, chain)
        if len(self.frames) < len(self.known):
            raise ProblemError("journal.jsonl", "no rows of it", "a frame", self.known[len(self.frames)]["number"])
        return self.frames

    def with_hidden(self, data: bytes) -> bytes:
        """Put back the first bytes of whole frames that are hidden (section 4)."""
        at = data.find(b"\0")
        while at >= 0 and data[at : at + 1] == b"\0":
            lines = data[at + 1 :].split(b"\n")
            try:
                record = read_record(b"{" + lines[0])
            except ValueError:
                break
            if record["kind"] != "commit" or len(lines) < record["rows"] + 2:
                break
            data = data[:at] + b"{" + data[at + 1 :]
            at += 1 + sum(len(line) + 1 for line in lines[: record["rows"] + 1])
            self.remarks.append("hidden")
        return data

    def read_frames(self, name: str, lines: list[bytes], chain: Chain) -> None:
        at = 0
        while at < len(lines) - 1:
            known = self.known[len(self.frames)] if len(self.frames) < len(self.known) else None
            error: object = "rows that are missing, or lead to another root"
            is_read = False
            try:
                ahead, record = chain.copy(), read_record(lines[at])
                is_read = True
                if record["kind"] != "commit" or known not in (None, record):
                    raise ValueError("a placement, or another commit than the chain has")
                if known is None:
                    ahead.add(lines[at], record)
                is_read = False
                rows = lines[at + 1 : at + 1 + record["rows"]]
                grown = self.grown + [sha256(b"\x00", row) for row in rows]
                is_whole = at + 1 + record["rows"] < len(lines)
                if is_whole and root_of(grown).hex() == record["tree_root"]:
                    self.frames.append((name, record, self.parsed(name, rows, record["number"])))
                    self.grown, at = grown, at + 1 + record["rows"]
                    chain.__dict__.update(ahead.__dict__)
                    continue
            except ValueError as found:
                error = found
            is_torn = name == "journal.jsonl" and known is None and not is_read
            if not is_torn or any(self.is_later(line, len(chain.commits)) for line in lines[at:]):
                raise ProblemError(name, error, "a frame", known["number"] if known else len(chain.commits))
            self.remarks.append("torn")
            return
        if lines[at] and name == "sealing.jsonl":
            after = [one["number"] for one in self.known[len(self.frames) :]]
            raise ProblemError(name, "a line without end", "a frame", *after[:1] or [len(chain.commits)])
        self.remarks += ["torn"] if lines[at] else []

    def tree_of(self, chain: Chain) -> list[bytes]:
        """Return subtrees whose root is that of the events in segments, as `root_over` takes them."""
        last = max(chain.placed.values(), key=lambda one: int(one["first"]), default=None)
        found: list[bytes] = Forest(
            [bytes.fromhex(each) for each in last["frontier"]] if last else [], chain.placed_size
        )
        return found

    def parsed(self, name: str, rows: list[bytes], number: int) -> list[Row]:
        found = []
        for row in rows:
            try:
                one = json.loads(row.decode())
                if not isinstance(one, dict) or canonical(one) != row or None in one.values():
                    raise ValueError(f"{row!r:.80} is no canonical JSON of an event")
            except (ValueError, RecursionError) as error:
                raise ProblemError(name, error, "the bytes of an event", number) from error
            found.append(one)
        return found

    def is_later(self, line: bytes, expected: int) -> bool:
        """Return whether a line ends with the record of a later commit: the line feed before it may be lost."""
        for found in re.finditer(rb"{", line) if b'"kind":"commit"' in line else ():
            with suppress(ValueError):
                record = read_record(line[found.start() :])
                return bool(record["kind"] == "commit" and record["number"] > expected)
        return False

    def covered(self, chain: Chain, count: int) -> int:
        """Return the events that the checkpoint covers; it must be a note that a crash leaves (section 6)."""
        path = self.ledger / "checkpoint"
        try:
            text = read_file(path).decode() if os.path.lexists(path) else None
            for number in range(count, -1, -1):
                size = chain.commits[number - 1]["tree_size"] if number else 0
                if text == (self.note_of(chain.commits[number - 1]).whole if number else None):
                    return int(size)
                if size <= chain.before:
                    break
            raise ValueError(f"{text!r:.200}")
        except (OSError, ValueError) as error:
            raise ProblemError("checkpoint", error, "a note of the newest commits") from error

    def note_of(self, commit: Row) -> "Whole":
        root = bytes.fromhex(commit["tree_root"])
        text = f"{self.origin}\n{commit['tree_size']}\n{base64.b64encode(root).decode()}\n\n"
        if "signature" in commit:
            text += f"\u2014 {self.origin} {commit['signature']}\n"
        return Whole(text, read_note(text))

    def read_segment(self, placement: Row) -> tuple[str, list[Row]]:
        """Read the segment, in place or in staging, and check each row on its own."""
        first, end = placement["first"], placement["first"] + placement["rows"]
        where, staged = f"segments/{first:012d}-{end:012d}.parquet", f"staging/{placement['segment_sha256']}.parquet"
        if (
            not os.path.lexists(self.ledger / where)
            and (self.ledger / staged).is_file()
            and not (self.ledger / staged).is_symlink()
        ):
            where = staged
        try:
            data = read_file(self.ledger / where, placement["segment_bytes"])
            if (
                len(data) != placement["segment_bytes"]
                or hashlib.sha256(data).hexdigest() != placement["segment_sha256"]
            ):
                raise ValueError("another size or SHA-256")
            count, columns, values = independent_parquet.read(data)
            own = columns[5:]
            if columns[:5] != list(ENVELOPE.items()) or own != sorted(own) or not {text for _, text in own} <= TEXTS:
                raise ValueError(f"columns {columns}")
            names = "".join(f"{name} {text}\n" for name, text in columns).encode()
            if count != placement["rows"] or sha256(names).hex() != placement["schema_sha256"]:
                raise ValueError("other rows, or another fingerprint")
        except (OSError, ValueError, KeyError, MemoryError) as error:
            raise ProblemError(where, f"{type(error).__name__}: {error}", "the segment of its placement") from error
        rows: list[Row] = [{} for _ in range(placement["rows"])]
        for name, column in values.items():
            for row, value in zip(rows, column, strict=True):
                if value is not None:
                    row[name] = value
        self.check_rows(where, rows, None)
        return where, rows

    def check_rows(self, where: str, rows: list[Row], number: int | None) -> None:
        """Check each row as far as its block of rows tells."""
        observed: set[str] | None = None
        recorded: set[str] = set()
        for at, row in enumerate(rows):
            is_new = at == 0 or rows[at - 1].get("run_id") != row.get("run_id")
            if not ENVELOPE.keys() - {"caused_by"} <= row.keys() or not isinstance(row["seq"], int):
                raise ProblemError(where, "a row without its envelope", "run_id, seq, time_us and type", number)
            place = max(0, row["seq"]) if is_new else rows[at - 1]["seq"] + 1
            flaw = flaw_of(row, place, False, self.types)
            has_company = place > 0 or (at + 1 < len(rows) and rows[at + 1]["run_id"] == row["run_id"])
            if flaw is None and row["type"] in self.stand_alone and has_company:
                flaw = "type", "the only event of its run"
            if is_new:
                observed = set(row["observes"]) if place == 0 and "observes" in row else None
                recorded = set(row.get("records", [])) if place == 0 else set()
            if flaw is None and self.types is not None:
                if not set(row.get("observes", [])) <= set(self.concerns.values()):
                    flaw = "observes", "concerns that there are"
                elif not set(row.get("records", [])) <= self.records:
                    flaw = "records", "event types, and fields of them that may be NULL"
                elif (
                    observed is not None
                    and self.concerns.get(row["type"]) not in {None, *observed}
                    and row["type"].partition(".v")[0] not in recorded
                ):
                    flaw = "type", "an event of a concern that its run observes, or of a type that it records"
            if flaw is not None:
                found = f"{flaw[0]} {row.get(flaw[0], 'NULL')!r}"
                raise ProblemError(where, found, flaw[1], number, row["run_id"], row["seq"])

    def add_rows(self, where: str, rows: list[Row], commits: list[Row]) -> None:
        """Add the rows to the tree, and compare it with the root of each commit."""
        done = commits[0]["tree_size"] - commits[0]["rows"]
        start = done
        for commit in commits:
            for row in rows[done - start : commit["tree_size"] - start]:
                self.tree.append(canonical(row))
            done = commit["tree_size"]
            if root_of(self.tree.frontier(done)).hex() != commit["tree_root"]:
                raise ProblemError(where, "other rows", "those of the tree", commit["number"])

    def check_nodes(self, first: int, end: int, chain: Chain) -> None:
        """Compare what `nodes` has of these events with the tree (section 5)."""
        data = self.bytes_of("nodes")
        for place, height, number in places_between(first, end):
            found = data[32 * place : 32 * place + 32]
            if found != self.tree.levels[height][number] and not (self.is_behind and first >= chain.before):
                raise ProblemError("nodes", found.hex() or "nothing", self.tree.levels[height][number].hex())

    def check_index(self, start: int, rows: list[Row], chain: Chain) -> None:
        """Compare the lines of the index for these rows with their placements, and with the file (section 5)."""
        if self.types is None:  # nor is it known which events stand alone
            return
        data, at = self.bytes_of("index.jsonl"), 0
        for number, one in enumerate(chain.added):
            place, at = at, at + one["index_bytes"]
            if not start <= one["first"] < start + len(rows):
                continue
            blocks: dict[str, Row] = {}
            for row in rows[one["first"] - start : one["first"] - start + one["rows"]]:
                run, us = row["run_id"], row["time_us"]
                is_alone = {"is_alone": True} if row["type"] in self.stand_alone else {}
                new = {"run": run, "first": row["seq"], "rows": 0, "first_us": us, **is_alone}
                block = blocks.setdefault(run, new)
                block |= {"rows": block["rows"] + 1, "last_us": us}
                block |= goes_on_from(row)
            line = canonical({"blocks": list(blocks.values()), "first": one["first"]}) + b"\n"
            if (len(line), sha256(line).hex()) != (one["index_bytes"], one["index_sha256"]):
                raise ProblemError("chain.jsonl", "another line of the index", f"{line!r:.200}")
            if data[place:at] != line and not (self.is_behind and start >= chain.before):
                raise ProblemError("index.jsonl", f"line {number + 1}: {data[place:at]!r:.200}", f"{line!r:.200}")

    def check_runs(self, where: str, rows: list[Row], commits: list[Row]) -> None:
        """Check what spans commits: seq, `continues`, `goes_on`, events that stand alone, and concerns."""
        start = commits[0]["tree_size"] - commits[0]["rows"]
        said_by = "chain.jsonl" if where.startswith("segments/") else where
        for commit in commits:
            own = rows[commit["tree_size"] - commit["rows"] - start : commit["tree_size"] - start]
            seen: dict[str, int] = {}
            for at, row in enumerate(own):
                run, seq = row["run_id"], row["seq"]
                flaw = None
                if run in self.alone:
                    flaw = f"more of run {run}", "one event alone"
                elif seq != self.seqs.get(run, 0):
                    flaw = f"seq {seq}", f"{self.seqs.get(run, 0)}"
                elif run in seen and own[at - 1]["run_id"] != run:
                    flaw = "a second block of rows", "each run in one"
                elif seq == 0 and "observes" in row:
                    kinds = [name.partition(".")[0] for name in row.get("records", [])]
                    admitted = {self.concerns[tag] for tag in self.concerns if tag.partition(".v")[0] in kinds}
                    self.observed[run] = {*row["observes"], *admitted}
                elif run in self.observed and self.concerns.get(row["type"]) not in {None, *self.observed[run]}:
                    flaw = f"type {row['type']}", "an event of a concern that its run observes"
                flaw = flaw or self.cuts.flaw(row, self.alone)
                if flaw is not None:
                    raise ProblemError(where, *flaw, commit["number"], run, seq)
                self.cuts.add(row)
                seen.setdefault(run, seq)
                self.seqs[run] = seq + 1
                if row["type"] in self.stand_alone:
                    self.alone.add(run)
            if sorted([run, seq] for run, seq in seen.items() if seq) != commit.get("continues", []):
                raise ProblemError(said_by, "other runs", "those that it continues", commit["number"])
            if not set(commit.get("goes_on", [])) <= seen.keys():
                raise ProblemError(said_by, "a run without events there", "runs of the commit", commit["number"])

    def check_strays(self, chain: Chain) -> None:
        named = {f"{one['first']:012d}-{one['first'] + one['rows']:012d}.parquet" for one in chain.placements}
        for name in sorted(set(os.listdir(self.ledger / "segments")) - named):
            raise ProblemError(f"segments/{name}", "a file of no placement", "only segments of the chain")

    def check_sizes(self, chain: Chain) -> None:
        of_nodes = 32 * len(list(places_between(0, chain.placed_size)))
        of_index = sum(one["index_bytes"] for one in chain.added)
        for name, expected in (("nodes", of_nodes), ("index.jsonl", of_index)):
            size = len(self.bytes_of(name))
            if size > expected or (size < expected and not self.is_behind):
                raise ProblemError(name, f"{size} bytes", expected)

    def check_signatures(self, notes: list["Whole"], chained: int) -> str:
        if self.key is None:
            return "signer not checked" if notes and notes[-1].note.signatures else "unsigned"
        if not notes:
            raise ProblemError("ledger.json", "no commit", "a signed note")
        for number, whole in enumerate(notes):
            is_signed = whole.note.has(self.key)
            if is_signed is False or (number == len(notes) - 1 and not is_signed):
                found = "no signature of the trusted key, or a wrong one"
                where = "chain.jsonl" if number < chained else "journal.jsonl"
                raise ProblemError(where, found, self.key[0], number)
        return "signed"

    def check_anchor(self, chain: Chain) -> None:
        if self.anchor is None:
            return
        try:
            note = read_note(read_file(self.anchor).decode())
            if note.origin != self.origin or (self.key is not None and not note.has(self.key)):
                raise ValueError("a checkpoint of another origin, or not signed by the trusted key")
        except (OSError, ValueError) as error:
            raise ProblemError(str(self.anchor), error, f"a checkpoint of {self.origin}") from error
        if note.size > chain.size or root_of(self.tree.frontier(note.size)) != note.root:
            raise ProblemError(
                "chain.jsonl", "fewer events than then, or others", f"the first {note.size} of the anchor"
            )


class Whole:
    """A note and its text."""

    def __init__(self, whole: str, note: Note):
        self.whole, self.note = whole, note


def is_placement(line: bytes) -> bool:
    try:
        return bool(read_record(line)["kind"] == "placement")
    except ValueError:
        return False


def later(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return each whole line, and all that is behind it."""
    found, at = [], 0
    while (stop := data.find(b"\n", at)) >= 0:
        found.append((data[at:stop], data[stop + 1 :]))
        at = stop + 1
    return found
