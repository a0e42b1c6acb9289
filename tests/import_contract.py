"""A contract for import-linter that says what modules may import, instead of what they may not.

A list of forbidden modules forgets one (`secrets`, `os.urandom`, `numpy.random`); a list of allowed ones does not.
"""

import sys

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


# See docs/decisions/imports-are-allow-listed.md.
class OnlyContract(Contract):
    """Modules below `source_modules` import only modules below `allowed_modules`.

    `stdlib` stands for the whole standard library. Indirect imports are covered because each allowed package of ours
    has a contract of its own.
    """

    type_name = "only"

    source_modules = fields.ListField(subfield=fields.StringField())
    allowed_modules = fields.ListField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        names = [str(name) for name in self.allowed_modules]  # type: ignore[attr-defined]
        allowed = (*names, *(sys.stdlib_module_names if "stdlib" in names else ()))
        sources = tuple(str(name) for name in self.source_modules)  # type: ignore[attr-defined]
        found = [
            (module, target)
            for module in sorted(graph.modules)
            if _is_below(module, sources)
            for target in sorted(graph.find_modules_directly_imported_by(module))
            if not _is_below(target, allowed)
        ]
        return ContractCheck(kept=not found, metadata={"found": found, "allowed": names})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for module, target in check.metadata["found"]:
            output.print_error(f"{module} imports {target}")
        output.print_error(f"expected imports of only: {', '.join(check.metadata['allowed'])}")


def _is_below(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)
