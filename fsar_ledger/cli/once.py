"""Commands that take an option with one value at most once: of two values, one would be dropped in silence."""

from collections import Counter
from typing import Any

from typer import TyperException
from typer.core import TyperCommand, TyperOption

from fsar_ledger.errors import UsageError


class Command(TyperCommand):
    """A command that refuses an option with one value that is given several times."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments.

        Raises:
            UsageError: An option that has one value is given several times.
            TyperException: Another mistake of the call; it knows the command, whose help the message names.
        """
        if not ctx.resilient_parsing:  # as in completion, where the call is not yet whole
            try:
                _, _, given = self.make_parser(ctx).parse_args(args=list(args))
            except TyperException as problem:
                vars(problem).update(ctx=ctx)  # the parser leaves it out
                raise
            for one, count in Counter(given).items():
                if isinstance(one, TyperOption) and count > 1 and not (one.multiple or one.is_flag):
                    raise UsageError(
                        f"{one.opts[0]}: found it {count} times, expected it once, since it has one value "
                        f"(see `{ctx.command_path} --help`)"
                    )
        return super().parse_args(ctx, args)
