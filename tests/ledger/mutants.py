"""Mutants of the verifier, each without one of its checks."""

import ast
import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import fsar_ledger

PACKAGE = Path(fsar_ledger.__file__).parent

CHECKED: dict[str, tuple[str, ...] | None] = {
    "verify/__init__.py": ("verify", "require_ledger", "_moment", "_look"),
    "verify/segment.py": None,
    "verify/report.py": ("read_anchor", "check_signatures", "check_anchor"),
    "rows/check.py": None,
    "store/manifest.py": None,
    "rows/segment.py": ("_read",),
    "rows/bounds.py": None,
    "rows/layout.py": None,
    "store/disk.py": ("read_document",),
    "log/note.py": ("__post_init__", "is_name", "has_signed", "parse_note", "_parse_signature", "doubt", "names"),
    "store/proof.py": ("parse_proof", "check_proof", "_event"),
    "store/segments.py": None,
    "v1.py": None,
    "verify/chain.py": None,
    "verify/trusted.py": ("find_trusted", "_removed", "manifest_of"),
    "store/record.py": (
        "parse_line",
        "_is_signature",
        "has_later_append",
        "has_later_commit",
        "_lines_with",
        "_record",
    ),
    "store/links.py": ("adds", "doubt", "_of_commit", "_of_runs", "_of_placement", "_starts", "root_at", "follow"),
    "store/journal.py": ("read_frames", "is_whole", "finish", "_is_sealed", "_commit"),
    "store/staging.py": ("table_of",),
    "store/derived.py": ("read_node",),
    "store/read.py": ("_placed_segment", "_coded", "open_chain"),
    "store/snapshot.py": (
        *("_settled", "look", "_follow", "_end_of_hidden"),
        *("behind", "covered", "check_chain_checkpoint"),
    ),
    "rows/blocks.py": ("flaw",),
}
"""The files that make checks, and the functions in them, None: all."""

_NO_CHECKS = frozenset({"_examine_all", "__str__"})

_COLLECTORS = ("problems", "_problems", "suspects", "doubts")


class Mutant(NamedTuple):
    """A module without one check.

    `name` (file, function, what was removed) is stable while the line of the check stays the same.
    """

    name: str
    line: int
    path: Path
    tree: ast.Module


def mutants() -> Iterator[Mutant]:
    """Yield a mutant for every check of `CHECKED`."""
    for file, functions in CHECKED.items():
        path = PACKAGE / "ledger" / file
        tree = ast.parse(path.read_text("utf-8"))
        for function in functions_of(tree):
            if function.name not in _NO_CHECKS and (functions is None or function.name in functions):
                yield from _mutants_of(path, tree, function)


def functions_of(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions and methods, except those inside functions, which belong to them."""
    bodies: list[ast.Module | ast.ClassDef] = [tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))]
    for body in bodies:
        yield from (node for node in body.body if isinstance(node, ast.FunctionDef))


def _mutants_of(path: Path, tree: ast.Module, function: ast.FunctionDef) -> Iterator[Mutant]:
    judged = set(map(id, _conditions(function)))
    for number, node in enumerate(ast.walk(function)):
        for what, change in [] if isinstance(node, ast.BoolOp) and id(node) not in judged else _changes(node):
            mutated = copy.deepcopy(tree)
            same = next(one for one in functions_of(mutated) if one.lineno == function.lineno)
            change(list(ast.walk(same))[number])
            yield Mutant(
                f"{path.parent.name}/{path.name}, {function.name}: {what}",
                getattr(node, "lineno", function.lineno),
                path,
                ast.fix_missing_locations(mutated),
            )


def _conditions(function: ast.FunctionDef) -> Iterator[ast.AST]:
    """Yield every part of an expression that decides something; elsewhere, `a or b` gives a default."""
    for node in ast.walk(function):
        match node:
            case ast.If(test=test) | ast.IfExp(test=test):
                yield from ast.walk(test)
            case (
                ast.Return(value=ast.BoolOp() | ast.UnaryOp() as value)
                | ast.Assign(value=ast.BoolOp() | ast.Call(func=ast.Name(id="all" | "any")) as value)
            ):
                yield from ast.walk(value)
            case ast.comprehension(ifs=tests):
                yield from (part for test in tests for part in ast.walk(test))


_Change = Callable[[ast.AST], None]


def _changes(node: ast.AST) -> Iterator[tuple[str, _Change]]:
    """Yield each way in which this node makes a check, with a function that removes it."""
    if isinstance(node, ast.If) and any(map(_is_finding, ast.walk(ast.Module(node.body, [])))):
        yield f"if {ast.unparse(node.test)}", _never
    for name in ("body", "orelse", "finalbody"):
        for at, statement in enumerate(_statements(node, name)):
            if _is_finding(statement) and not (isinstance(node, ast.If) and name == "body" and not node.orelse):
                yield ast.unparse(statement), _without(name, at)
    if isinstance(node, ast.BoolOp):
        for at, value in enumerate(node.values):
            yield f"{ast.unparse(value)} (in {ast.unparse(node)})", _without("values", at)
    if isinstance(node, ast.IfExp) and _makes_problem(node.orelse) != _makes_problem(node.body):
        yield ast.unparse(node), _never
    if isinstance(node, ast.Compare) and len(node.ops) > 1:
        yield f"the lower bound of {ast.unparse(node)}", _upper_only
    if isinstance(node, ast.For) and isinstance(node.iter, ast.Tuple):
        for at, element in enumerate(node.iter.elts):
            yield f"{ast.unparse(element)} (in for)", lambda other, at=at: other.iter.elts.pop(at)  # type: ignore[misc]
    if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Dict) and ast.unparse(node.target) == "pairs":
        for at, key in enumerate(node.value.keys):
            yield f"pair {ast.unparse(key or node)}", lambda other, at=at: _without_pair(other.value, at)  # type: ignore[misc]


def _statements(node: ast.AST, name: str) -> list[ast.AST]:
    found = getattr(node, name, [])
    return found if isinstance(found, list) else []


def _is_finding(node: ast.AST) -> bool:
    """Return whether this is a statement in which a check reports what it found."""
    match node:
        case ast.Raise():
            return True
        case ast.Return(value=value):
            return value is not None and (_makes_problem(value) or ast.unparse(value) in ("False", "(None, None)"))
        case ast.Expr(value=ast.Yield() | ast.YieldFrom()):
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=collector, attr="append"))):
            return _is_collector(collector)
        case ast.AugAssign(target=target) | ast.Assign(targets=[target]):
            return _is_collector(target) and not (
                isinstance(node, ast.Assign) and isinstance(node.value, ast.List | ast.IfExp | ast.Tuple)
            )
    return False


def _is_collector(node: ast.AST) -> bool:
    return ast.unparse(node).rpartition(".")[2] in _COLLECTORS


def _makes_problem(node: ast.AST) -> bool:
    makers = ("Problem", "fail", "unexpected", "Flaw")
    texts = (
        [one.value if isinstance(one, ast.Constant) else one for one in node.elts]
        if isinstance(node, ast.Tuple)
        else []
    )
    is_found_and_expected = bool(texts) and all(isinstance(text, str | ast.JoinedStr) for text in texts)
    is_doubt = len(texts) == 3 and isinstance(texts[0], str)
    return (
        is_found_and_expected
        or is_doubt
        or any(isinstance(one, ast.Call) and ast.unparse(one.func) in makers for one in ast.walk(node))
    )


def _never(node: ast.AST) -> None:
    """Make the condition never lead to a problem."""
    is_other_way = isinstance(node, ast.IfExp) and _makes_problem(node.orelse)
    node.test = ast.Constant(is_other_way)  # type: ignore[attr-defined]


def _without(name: str, at: int) -> _Change:
    def change(node: ast.AST) -> None:
        values = getattr(node, name)
        if name == "values":
            values.pop(at)
        elif isinstance(values[at], ast.Assign):
            values[at].value = ast.List([], ast.Load())
        elif isinstance(values[at], ast.Return):
            is_refusal = ast.unparse(values[at]) == "return False"
            values[at] = ast.Return(ast.Constant(True) if is_refusal else ast.List([], ast.Load()))
        elif isinstance(values[at], ast.Expr) and isinstance(values[at].value, ast.Yield | ast.YieldFrom):
            values[at] = ast.Expr(ast.YieldFrom(ast.Tuple([], ast.Load())))  # still a generator
        else:
            values[at] = ast.Pass()

    return change


def _upper_only(node: ast.AST) -> None:
    assert isinstance(node, ast.Compare)
    node.left = node.comparators.pop(0)
    node.ops.pop(0)


def _without_pair(pairs: ast.Dict, at: int) -> None:
    pairs.keys.pop(at)
    pairs.values.pop(at)
