"""What holds for all tests."""

import gc


def pytest_collection_finish() -> None:
    """The libraries and the tests live to the end: looking for garbage among them again and again takes a twelfth of all time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def pytest_unconfigure() -> None:
    """At the end all is garbage again: libraries complain of what is left."""
    gc.unfreeze()
    gc.collect()
