"""Malicious and damaged `.npz` files are refused before their arrays are loaded."""

import hashlib
import io
import struct
import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.npz import names_in, read_arrays, write_arrays


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def zipped(name, content, **options):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content, **options)
    return buffer.getvalue()


def member(**arrays):
    """The bytes of the only .npy in an .npz."""
    with zipfile.ZipFile(io.BytesIO(npz(**arrays))) as archive:
        return archive.read(archive.namelist()[0])


def test_a_small_file_that_unpacks_to_much_is_refused_before_it_is_unpacked():
    """33 kB took half a gigabyte of memory."""
    packed = zipped("a.npy", member(a=np.zeros(4_000_000)))
    assert len(packed) < 40_000
    with pytest.raises(InvalidInput, match="would unpack to 32000128; accepted are 200 times"):
        read_arrays(packed, "a")
    assert read_arrays(zipped("a.npy", member(a=np.zeros(900_000))), "a")["a"].shape == (900_000,)


def test_an_array_with_too_many_rows_is_refused_by_its_header():
    assert read_arrays(npz(a=np.zeros(10)), "a", 10)["a"].shape == (10,)
    with pytest.raises(InvalidInput, match=r"a.npy has 11 rows; accepted are 10"):
        read_arrays(npz(a=np.zeros(11)), "a", 10)


def test_a_file_with_more_numbers_than_its_reader_accepts_is_refused():
    content = npz(a=np.zeros(6), b=np.zeros(5))
    assert read_arrays(content, "ab", most=11).keys() == {"a", "b"}
    with pytest.raises(InvalidInput, match="holds 11 numbers; accepted are 10"):
        read_arrays(content, "ab", most=10)


def test_the_bytes_are_those_of_numpy_whatever_the_version_of_python():
    """Before 3.11.4, `zipfile` wrote other headers: a demo on Debian 12 had other results."""
    given = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["x", "yz"]), "c": np.float64(0.5)}
    content = write_arrays(given)
    assert hashlib.sha256(content).hexdigest()[:16] == "bef9678a28fc517c"
    if sys.version_info >= (3, 11, 4):
        assert content == npz(**given)


def test_plain_arrays_are_read_back():
    given = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["x", "yz"]), "c": np.float64(0.5)}
    for content in (npz(**given), write_arrays(given)):
        arrays = read_arrays(content, "abc")
        assert arrays.keys() == given.keys()
        for name, value in given.items():
            np.testing.assert_array_equal(arrays[name], value)


def test_the_same_arrays_give_the_same_bytes_and_their_names():
    given = {"a": np.arange(3), "b": np.eye(2)}
    assert write_arrays(given) == write_arrays(dict(given))
    assert names_in(write_arrays(given)) == ["a", "b"]
    assert names_in(b"no zip") == []


def test_compressed_arrays_in_fortran_order_are_read_back():
    buffer, values = io.BytesIO(), np.asfortranarray(np.arange(6.0).reshape(2, 3))
    np.savez_compressed(buffer, a=values)
    np.testing.assert_array_equal(read_arrays(buffer.getvalue(), "a")["a"], values)


def with_header(text, version=b"\x01\x00"):
    length = struct.pack("<H" if version == b"\x01\x00" else "<I", len(text))
    return zipped("a.npy", b"\x93NUMPY" + version + length + text + bytes(8))


HEADER = "{{'descr': {}, 'fortran_order': False, 'shape': {}}}\n"


@pytest.mark.parametrize(
    "header",
    [
        HEADER.format("('<f8',)", "()"),
        HEADER.format("'<f8'", "(True,)"),
        HEADER.format("'<f8'", "(-1,)"),
        "{[]: 1}\n",
        "{'descr':\n",
        "  1\n 2\n",
        "-" * 9000 + "1\n",
    ],
    ids=lambda header: header[:40],
)
def test_a_header_that_numpy_cannot_read_is_refused(header):
    with pytest.raises(InvalidInput):
        read_arrays(with_header(header.encode()), "a")


def test_a_header_that_says_it_is_long_is_not_read_to_its_end():
    """A file of three megabytes took one gigabyte of memory."""
    packed = with_header(b" " * 7_000_000 + b"\n", b"\x03\x00")
    tracemalloc.start()
    with pytest.raises(InvalidInput, match="not a readable"):
        read_arrays(packed, "a")
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()


def test_a_list_of_many_members_is_not_read():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for number in range(2500):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(InvalidInput, match=r"list of members has .* bytes; accepted are 100000"):
        read_arrays(buffer.getvalue(), "a")
    assert names_in(buffer.getvalue()) == []


def test_a_list_whose_end_belittles_it_is_not_read():
    """Python's reader believes the record of a large zip before the end, if there is one."""
    false = _belittled(b"")
    assert len(zipfile.ZipFile(io.BytesIO(false)).namelist()) == 2500
    with pytest.raises(InvalidInput, match="accepted are 100000"):
        read_arrays(false, "a")


def test_a_list_whose_size_stands_far_before_the_end_is_not_read():
    """Pythons of late 2025 and after believe the record at the locator's offset first."""
    with pytest.raises(InvalidInput, match="accepted are 100000"):
        read_arrays(_belittled(bytes(56)), "a")


def _belittled(between: bytes) -> bytes:
    """A zip with a long list of members, whose end has a false size and the record for large zips,
    before `between` and its locator, the true one."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for number in range(2500):
            archive.writestr(f"{number}.npy", b"")
    packed = buffer.getvalue()
    end = list(struct.unpack("<4s4H2LH", packed[-22:]))
    size, offset = end[5:7]
    large = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, 2500, 2500, size, offset)
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, len(packed) - 22, 1)
    end[3:6] = 1, 1, 46
    return packed[:-22] + large + between + locator + struct.pack("<4s4H2LH", *end)


def test_a_pickle_is_never_loaded(tmp_path):
    class Bad:
        def __reduce__(self):
            return (open, (str(tmp_path / "written"), "w"))

    with pytest.raises(InvalidInput, match=r"a\.npy holds object"):
        read_arrays(npz(a=np.array([Bad()], dtype=object)), "a")
    assert not (tmp_path / "written").exists()


def test_a_bomb_is_not_unpacked():
    header = member(a=np.zeros(1, np.uint8)).replace(b"(1,), }", b"(99999999,), }")[:-8]
    bomb = zipped("a.npy", header + b"\0" * (99_999_999 + 128 - len(header)))
    assert len(bomb) < 200_000
    with pytest.raises(InvalidInput, match="would unpack to 100000127"):
        read_arrays(bomb, "a")


def test_more_numbers_than_fit_into_memory_are_refused_in_a_file_that_is_long_enough():
    """Random bytes keep the file from looking like a bomb."""
    buffer, noise = io.BytesIO(), np.random.default_rng(0).integers(0, 256, 200_000, np.uint8)
    np.savez_compressed(buffer, a=np.zeros(2**25, np.uint8), b=noise)
    with pytest.raises(InvalidInput, match="holds 33754432 numbers; accepted are 33554432"):
        read_arrays(buffer.getvalue(), "ab")


def test_a_header_that_promises_more_numbers_than_the_file_has_is_refused():
    content = member(a=np.zeros(3)).replace(b"(3,), }", b"(9,), }")
    with pytest.raises(InvalidInput, match="not as long as its shape"):
        read_arrays(zipped("a.npy", content), "a")


def test_texts_of_no_length_are_refused():
    """Any number of them fits into any file."""
    content = member(a=np.array(["x"])).replace(b"<U1", b"<U0").replace(b"(1,)", b"(9,)")[:-4]
    with pytest.raises(InvalidInput, match=r"a\.npy holds <U0"):
        read_arrays(zipped("a.npy", content), "a")


def test_a_directory_that_lies_about_the_size_is_refused():
    content = zipped("a.npy", member(a=np.zeros(1000)))
    at = content.index(b"PK\x01\x02") + 24  # the uncompressed size in the central directory
    lying = content[:at] + struct.pack("<I", 200) + content[at + 4 :]
    with pytest.raises(InvalidInput):
        read_arrays(lying, "a")


def test_a_damaged_compressed_member_is_refused():
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.random.default_rng(0).normal(size=1000))
    content = bytearray(buffer.getvalue())
    content[60:400] = b"\xff" * 340
    with pytest.raises(InvalidInput, match="not a readable"):
        read_arrays(bytes(content), "a")


def test_half_characters_are_refused():
    content = member(a=np.array(["xy"]))
    content = content[:-8] + struct.pack("<2I", 0xD800, 0x61)
    with pytest.raises(InvalidInput, match="not a readable"):
        read_arrays(zipped("a.npy", content), "a")


@pytest.mark.parametrize("name", ["../a.npy", "a/b.npy", "a.txt", "a"])
def test_members_with_other_names_are_refused_with_the_accepted_ones(name):
    with pytest.raises(InvalidInput, match=r"accepted: a\.npy"):
        read_arrays(zipped(name, b"x"), "a")


@pytest.mark.parametrize(
    "content", [b"", b"not a zip", npz(a=np.zeros(9))[:-30], b"--form\r\n" + npz(a=np.zeros(9))]
)
def test_bytes_that_are_no_npz_are_refused(content):
    with pytest.raises(InvalidInput, match="not a readable"):
        read_arrays(content, "a")


def test_a_member_that_is_no_npy_is_refused():
    with pytest.raises(InvalidInput, match="not a readable"):
        read_arrays(zipped("a.npy", b"not an array"), "a")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.full(10_001, "x"), "holds 10001 texts; accepted: 10000"),
        (np.array("a\x1b[2J"), "control characters in its texts"),
    ],
    ids=["many", "control"],
)
def test_texts_that_no_recording_has_are_refused(array, message):
    with pytest.raises(InvalidInput, match=message):
        read_arrays(npz(a=array), "a")


def test_a_member_that_comes_twice_is_refused():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.npy", member(a=np.zeros(2)))
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("a.npy", member(a=np.zeros(2)))
    with pytest.raises(InvalidInput, match="twice"):
        read_arrays(buffer.getvalue(), "a")
