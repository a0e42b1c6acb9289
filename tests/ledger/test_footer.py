import pytest

from fsar_ledger.ledger.footer import Column, Page, read_footer, read_page

I32, I64, BINARY, LIST, STRUCT = 5, 6, 8, 9, 12


def number(value: int) -> bytes:
    """A number below 64, as Thrift's compact protocol holds it."""
    return bytes([value << 1])


def struct(*fields: tuple[int, int, bytes]) -> bytes:
    """A struct of these fields: number, kind, value."""
    found, last = b"", 0
    for field, kind, value in fields:
        found += bytes([(field - last) << 4 | kind]) + value
        last = field
    return found + b"\0"


def footer(*more: tuple[int, int, bytes], kind: int = 2) -> bytes:
    """A footer of one column, whose chunk has these fields too."""
    about = struct((1, I32, number(kind)), (3, LIST, b"\x18\x01a"), (7, I64, number(9)), (9, I64, number(4)))
    chunk = struct(*sorted([(3, STRUCT, about), *more]))
    return struct((4, LIST, b"\x1c" + struct((1, LIST, b"\x1c" + chunk))))


def test_a_column_is_read_from_the_bytes_of_a_footer() -> None:
    assert read_footer(footer()) == ((Column("a", "INT64", 4, 9, None, (), (), has_index=False),), False)


@pytest.mark.parametrize("field", [(1, BINARY, b"\x05other"), (8, STRUCT, struct()), (9, BINARY, b"\x01x")])
def test_a_column_that_is_elsewhere_or_encrypted_is_refused(field: tuple[int, int, bytes]) -> None:
    with pytest.raises(ValueError, match="a column in another file or encrypted"):
        read_footer(footer(field))


def test_a_column_of_a_type_that_parquet_has_not_is_refused() -> None:
    assert read_footer(footer(kind=7))[0][0].type == "FIXED_LEN_BYTE_ARRAY"
    with pytest.raises(ValueError, match="a column of type 8"):
        read_footer(footer(kind=8))


def test_a_page_of_a_kind_that_parquet_has_not_is_refused() -> None:
    sizes = ((2, I32, number(8)), (3, I32, number(6)))
    data = struct((1, I32, number(0)), *sizes, (5, STRUCT, struct((1, I32, number(3)), (2, I32, number(0)))))
    assert read_page(data + b"rest") == (Page(3, 0, 6, 8, is_data=True), len(data))
    for kind in (1, 9):
        with pytest.raises(ValueError, match=f"a page of kind {kind}"):
            read_page(struct((1, I32, number(kind)), *sizes))


@pytest.mark.parametrize("depth", [8, 9])
def test_structs_in_each_other_have_a_bound(depth: int) -> None:
    data = struct()
    for _ in range(depth):
        data = struct((5, STRUCT, data))
    with pytest.raises(ValueError, match="more than 8 structs" if depth > 8 else "as field 4"):
        read_footer(data)


def test_a_name_that_is_no_text_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a name"):
        read_footer(footer().replace(b"\x18\x01a", b"\x15\x02"))


def test_bytes_and_lists_longer_than_what_is_left_are_refused() -> None:
    with pytest.raises(ValueError, match="100 bytes, expected at most the 2 that are left"):
        read_footer(struct((1, BINARY, b"\x64x")))
    with pytest.raises(ValueError, match="a list of 100, expected at most the 2 bytes that are left"):
        read_footer(struct((1, LIST, b"\xf5\x64\x02")))
