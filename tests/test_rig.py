"""The rig file: what is refused, and that the message leads to the line that must be mended."""

from __future__ import annotations

import json
import re
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import TriggerMode
from thermacq.errors import RigError
from thermacq.rig import Rig, load_rig, parse_rig
from thermacq.settings import explain
from thermacq.toml_lines import line_of

MINIMAL = "[cameras.left]\ndriver = 'test-pattern'\n"


def refused(text: str) -> str:
    with pytest.raises(RigError) as caught:
        parse_rig(text, "rig.toml")
    return caught.value.what


def test_a_minimal_rig_has_every_default():
    rig = parse_rig(MINIMAL)
    assert rig.trigger.mode is TriggerMode.SOFTWARE
    assert rig.trigger.frame_rate_hz == 50.0
    assert rig.store.compression == "lz4"
    assert rig.cameras["left"].settings == {}


def test_the_resolved_rig_survives_json():
    rig = parse_rig(MINIMAL + "[trigger]\nmode = 'free_run'\n[scene]\nwave = {height_m = 0.02}\n")
    assert Rig.model_validate(json.loads(json.dumps(rig.model_dump(mode="json")))) == rig


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("[triger]\nmode = 'software'\n" + MINIMAL, 1, "unknown key 'triger'; did you mean 'trigger'?"),
        (
            MINIMAL + "[trigger]\nframe_rate = 50.0\n",
            4,
            "unknown key 'trigger.frame_rate'; did you mean 'frame_rate_hz'?",
        ),
        (
            MINIMAL + "serail = 'A1'\n",
            3,
            "unknown key 'cameras.left.serail'; did you mean 'serial'?",
        ),
        (
            "cameras = {left = {driver = 'x'},\n right = {drivr = 'x'}}".replace("\n", ""),
            1,
            "unknown key 'cameras.right.drivr'; did you mean 'driver'?",
        ),
        (
            MINIMAL + "[store]\n# a comment\ncompression = 'lz5'\n",
            5,
            "store.compression: input should be 'lz4', 'zstd' or 'none', not 'lz5'",
        ),
        (
            MINIMAL + "[trigger]\nframe_rate_hz = '50'\n",
            4,
            "trigger.frame_rate_hz: input should be a valid number, not '50'",
        ),
        (MINIMAL + "[trigger]\nframe_rate_hz = nan\n", 4, "should be a finite number, not nan"),
        (MINIMAL + "[trigger]\nframe_rate_hz = 0\n", 4, "should be greater than 0, not 0"),
        (MINIMAL + "pin_to_core = true\n", 3, "cameras.left.pin_to_core: input should be a valid integer"),
        (
            MINIMAL + "[trigger]\nmode = 'sofware'\n",
            4,
            "should be 'free_run', 'software' or 'hardware', not 'sofware'",
        ),
        ("cameras = 3\n", 1, "cameras: must be a table, not 3"),
        ("[cameras]\nleft = 'test-pattern'\n", 2, "cameras.left: must be a table, not 'test-pattern'"),
        ("[cameras.left]\nserial = 'A1'\n", 1, "'cameras.left.driver' is missing"),
        (MINIMAL + "[cameras.'my camera']\ndriver = 'x'\n", 3, "a device name is a letter"),
        (
            MINIMAL + "[trigger]\nmode = 'hardware'\n",
            4,
            "trigger.mode: mode 'hardware' needs trigger.source; known sources: none",
        ),
        (
            MINIMAL + "[trigger]\nsource = 'bx'\n[trigger_sources.box]\ndriver = 'x'\n",
            4,
            "there is no trigger source 'bx' in this rig; did you mean 'box'?",
        ),
        (
            MINIMAL + "[probes.left]\ndriver = 'x'\n",
            3,
            "probes.left: the name 'left' is already taken by cameras.left",
        ),
        ("[cameras]\n", 1, "cameras: "),
        (MINIMAL + "[board]\nrows = 6.5\n", 4, "board.rows: input should be a valid integer"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(text, line, message):
    what = refused(text)
    assert what.startswith(f"rig.toml, line {line}: "), what
    assert message in what


def test_a_rig_without_cameras_is_refused():
    assert refused("name = 'empty'") == "rig.toml: 'cameras' is missing"


def test_all_mistakes_are_told_at_once():
    what = refused("[cameras.left]\ndriver = 3\ncolour = 1\n[trigger]\nmode = 'x'\n")
    assert [line.split(":")[0] for line in what.splitlines()] == [f"rig.toml, line {n}" for n in (5, 2, 3)]


def test_text_that_is_no_toml_names_the_line():
    assert "line 2" in refused("[cameras.left]\ndriver = \n")


@pytest.fixture
def rig_file(tmp_path):
    def _write(text: str, name: str = "rig.toml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return _write


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (
            "[cameras.left]\ndriver = 'test-patern'\n",
            2,
            "cameras.left.driver: there is no camera driver named 'test-patern'. Did you mean 'test-pattern'?",
        ),
        (
            MINIMAL + "[cameras.left.settings]\nrows = 32\ncolums = 64\n",
            5,
            "cameras.left.settings: unknown key 'colums'; did you mean 'columns'?",
        ),
        (
            MINIMAL + "settings = {rows = 32, columns = 5}\n",
            3,
            "cameras.left.settings: columns: input should be greater than",
        ),
        (
            MINIMAL + "[probes.near]\ndriver = 'test-pattern'\n",
            4,
            "probes.near.driver: there is no wave probe driver named 'test-pattern'",
        ),
    ],
)
def test_drivers_and_their_settings_are_checked_with_their_line(rig_file, text, line, message):
    path = rig_file(text)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert caught.value.what.startswith(f"{path}, line {line}: {message}")


def test_a_scene_file_replaces_keys_of_the_scene(rig_file):
    rig = rig_file(MINIMAL + "[scene]\nkind = 'still'\ndepth_m = 0.5\n")
    scene = rig_file("kind = 'wave'\n[wave]\nheight_m = 0.1\n", "scene.toml")
    assert load_rig(rig, scene).scene == {"kind": "wave", "depth_m": 0.5, "wave": {"height_m": 0.1}}


def test_files_that_cannot_be_read_are_explained(tmp_path, rig_file):
    with pytest.raises(RigError, match="there is no file"):
        load_rig(tmp_path / "none.toml")
    with pytest.raises(RigError, match="cannot be read"):
        load_rig(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\x89HDF\r\n\xff\xfe")
    with pytest.raises(RigError, match="cannot be read as text"):
        load_rig(binary)


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_bytes(b"\xef\xbb\xbf" + MINIMAL.encode())
    assert list(load_rig(path).cameras) == ["left"]


def test_the_schema_describes_every_table():
    schema = Rig.model_json_schema()
    assert set(schema["properties"]) == set(Rig.model_fields)
    assert schema["additionalProperties"] is False


DOCUMENT = '''\
title = "a # b = [c]"  # no = key

[a]
text = """
[not.a.table]
key = 1
"""
list = [
  1,
  {deep = {er = 2}},  # a comment ] }
]
"quoted key".'x.y' = 1979-05-27 07:32:00
[a.b.c]
d = {e = 1, f = [{g = 3}]}
[[points]]
x = 1
[[points]]
x = 2
[points.colour]
red = 3
'''


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ("title", 1),
        ("a", 3),
        ("a.text", 4),
        ("a.list", 8),
        ("a.list.1", 10),
        ("a.list.1.deep.er", 10),
        ("a.b", 13),
        ("a.b.c.d.f.0.g", 14),
        ("a.b.c.d.missing", 14),
        ("points.0.x", 16),
        ("points.1.x", 18),
        ("points.1.colour.red", 20),
        ("a.missing.deep", 3),
        ("nowhere", 0),
    ],
)
def test_lines_of_keys_at_every_depth(place, line):
    tomllib.loads(DOCUMENT)
    assert line_of(DOCUMENT, place.split(".")) == line


def test_lines_of_quoted_keys():
    assert line_of(DOCUMENT, ["a", "quoted key", "x.y"]) == 12


plain_keys = st.text("abcdefgh-_", min_size=1, max_size=6)
tables = st.recursive(
    st.one_of(st.integers(-9, 9), st.booleans(), st.text(max_size=8), st.lists(st.integers(), max_size=3)),
    lambda inner: st.dictionaries(plain_keys, inner, min_size=1, max_size=3),
    max_leaves=12,
)


def inline(value) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {inline(item)}" for key, item in value.items()) + "}"
    return json.dumps(value).replace("\x7f", "\\u007f")


def leaves(value, place=()):
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, (*place, key))
    else:
        yield place


@given(st.dictionaries(plain_keys, tables, min_size=1, max_size=5))
def test_every_key_of_any_document_is_found_on_its_line(document):
    text = "\n".join(f"# line\n{key} = {inline(value)}" for key, value in document.items())
    text = re.sub(r"\\ud[89ab][0-9a-f]{2}\\ud[c-f][0-9a-f]{2}", "?", text)
    tomllib.loads(text)
    for number, (key, value) in enumerate(document.items(), start=1):
        for place in leaves(value, (key,)):
            assert line_of(text, place) == 2 * number


def test_a_message_without_text_still_names_file_and_place():
    from pydantic import ValidationError

    with pytest.raises(ValidationError) as caught:
        Rig.model_validate({"cameras": {"left": {"driver": "x", "serail": "1"}}})
    assert explain(caught.value, Rig, "run.h5") == (
        "run.h5: unknown key 'cameras.left.serail'; did you mean 'serial'?"
    )


def test_correction_files_are_relative_to_the_rig_file(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        '[cameras.left]\ndriver = "test-pattern"\n'
        '[correction]\nshading = false\nfiles = { left = "irt/left.correction.h5" }\n'
    )
    table = load_rig(path).correction
    assert table.files == {"left": str(tmp_path / "irt" / "left.correction.h5")}
    assert not table.shading
    assert table.nonuniformity


def test_a_correction_of_no_camera_is_refused():
    text = '[cameras.left]\ndriver = "x"\n[correction.files]\nrihgt = "a.correction.h5"\n'
    assert "line 4: correction.files.rihgt: there is no camera 'rihgt'" in refused(text)
