from tests.cli.conftest import call, ledger

__all__ = ["call", "ledger"]
