"""The commands `key new` and `key public`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import examples
from fsar_ledger.cli.terminal import show

group = typer.Typer()


@group.callback()
def _keys() -> None:
    """Make keys that sign ledgers."""


@group.command(
    "new", epilog=examples("fsar-ledger key new fleet.key", "fsar-ledger key new arm.key --name example.org/arm")
)
def key_new(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Where the secret key goes; the public one goes to FILE.pub.", show_default=False
        ),
    ],
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The origin of the ledgers it signs.", show_default="fsar-ledger/simulated"),
    ] = None,
) -> None:
    """Make a key that signs ledgers, and print its public half.

    Keep FILE secret: whoever has it can rewrite every ledger that it signed. The public half is for everyone who
    verifies.
    """
    from fsar_ledger.api import keys as api

    show(printable.line(str(api.key_new(file, name))))


@group.command(
    "public", epilog=examples('fsar-ledger key public out/fleet.key.pub --name "example.org/fleet/ablation"')
)
def key_public(
    file: Annotated[
        str, typer.Argument(metavar="KEY", help="A public key: a .pub file, or the key itself.", show_default=False)
    ],
    name: Annotated[str, typer.Option(metavar="NAME", help="The origin of the ledger to verify.", show_default=False)],
) -> None:
    """Print a public key under another name, for `verify --trusted-key`.

    `reproduce` signs each ledger with one secret under a name of its own.
    """
    from fsar_ledger.api import keys as api

    show(printable.line(str(api.key_public(file, name))))
