from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.errors import ImportDataError
from thermacq.evaluation.textseries import read_series


@pytest.mark.parametrize(
    "text",
    [
        "0 1\n1 2\n2 -3\n",
        "# logger 7\n\n0.0\t1.0\n1.0\t2.0\n2.0\t-3.0\n",
        "time,eta\n0,1\n1,2\n2,-3\n",
        '"t [s]";"eta [m]"\r\n0,0;1,0\r\n1,0;2,0\r\n2,0;-3,0\r\n',
        "\ufeff0, 1\n1, 2\n2, -3",
        "% c\n 0.0e0   1.0e+00 \n 1 2\n 2 -3",
    ],
)
def test_the_usual_ways_to_write_two_columns(tmp_path, text):
    path = tmp_path / "series.txt"
    path.write_bytes(text.encode())
    time, value = read_series(path)
    assert time == pytest.approx([0, 1, 2])
    assert value == pytest.approx([1, 2, -3])


def test_columns_by_name_and_number_and_unit(tmp_path):
    path = tmp_path / "series.csv"
    path.write_text("n,t,a,b\n1,0.0,5,7\n2,0.5,6,\n3,1.0,7,9\n")
    time, value = read_series(path, time_column="t", value_column="b", unit="mm")
    assert time == pytest.approx([0, 0.5, 1])
    assert value == pytest.approx([0.007, np.nan, 0.009], nan_ok=True)
    assert read_series(path, time_column="2", value_column="3", unit="cm")[1] == pytest.approx(
        [0.05, 0.06, 0.07]
    )


def test_one_column_and_a_rate(tmp_path):
    path = tmp_path / "series.txt"
    path.write_text("1\n2\nnan\n")
    time, value = read_series(path, rate_hz=50)
    assert time == pytest.approx([0, 0.02, 0.04])
    assert value == pytest.approx([1, 2, np.nan], nan_ok=True)


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (b"", {}, "holds no numbers"),
        (b"# only\n", {}, "holds no numbers"),
        (b"time eta\n", {}, "holds no numbers"),
        (b"0 1\n1 2 3\n", {}, r"line 2.*has 3 columns, not 2"),
        (b"0 1\n1 wet\n", {}, r"line 2: '1 wet' is not a row of numbers"),
        (b"1\n2\n", {}, r"1 column\(s\), none of them is '2'"),
        (b"0 1\n1 2\n", {"value_column": "eta"}, "none of them is 'eta'"),
        (b"0 1\n1 2\n", {"value_column": "0"}, "none of them is '0'"),
        (b"0 1\n1 2\n", {"unit": "inch"}, "unknown unit 'inch'"),
        (b"0 1\n1 2\n", {"rate_hz": 0.0}, "0 Hz is impossible"),
        (b"0 1\n1 2\n", {"rate_hz": float("nan")}, "impossible"),
        (b"0 1\n1 2\n", {"rate_hz": 5.0, "time_column": "1"}, "exclude each other"),
        (b"nan 1\n1 2\n", {}, "time is missing in row 1"),
        (b"\x89HDF\r\n\x1a\n\0\0\0", {}, "not a text file"),
        (b"ab\0cd", {}, "not a text file"),
        (b"a b c\n1 2\n", {"value_column": "c"}, "more columns than it has numbers"),
    ],
)
def test_bad_files_are_refused_with_a_reason(tmp_path, content, options, message):
    path = tmp_path / "bad.txt"
    path.write_bytes(content)
    with pytest.raises(ImportDataError, match=message):
        read_series(path, **options)


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(ImportDataError, match="there is no file"):
        read_series(tmp_path / "none.txt")
    with pytest.raises(ImportDataError, match="cannot be read"):
        read_series(tmp_path)


@settings(max_examples=100, deadline=None)
@given(content=st.binary(max_size=200))
def test_any_bytes_give_a_series_or_an_explained_error(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz") / "f.txt"
    path.write_bytes(content)
    try:
        time, value = read_series(path)
    except ImportDataError:
        return
    assert time.shape == value.shape
