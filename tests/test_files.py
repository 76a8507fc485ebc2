"""Files that appear whole or not at all, and tables that a killed process may have cut."""

import json
from pathlib import Path

import pytest

from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import CsvTable, replaced, write_json


def test_a_file_is_replaced_at_the_end_of_the_block(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")
    with replaced(file) as part:
        assert (part.parent, part.suffix) == (file.parent, ".txt")
        part.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    with pytest.raises(KeyError), replaced(file) as part:
        part.write_text("half")
        raise KeyError
    assert file.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_json_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


# ------------------------------------------------------------------ tables


@pytest.fixture
def table(tmp_path: Path) -> CsvTable:
    return CsvTable(tmp_path / "a.csv", ("name", "value"))


def test_a_table_reads_back(table: CsvTable, tmp_path: Path) -> None:
    assert table.read() == []
    table.append({"name": "a,b", "value": 1}, {"value": 0.5, "name": "c"})
    assert (tmp_path / "a.csv").read_text() == 'name,value\n"a,b",1\nc,0.5\n'
    assert table.read() == [{"name": "a,b", "value": "1"}, {"name": "c", "value": "0.5"}]
    table.keep(lambda row: row["value"] != "1")
    assert table.read() == [{"name": "c", "value": "0.5"}]


def test_half_a_line_goes_before_the_next(table: CsvTable, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("name,value\na,1\nb,")
    assert table.read() == [{"name": "a", "value": "1"}]
    table.append({"name": "c", "value": 3})
    assert (tmp_path / "a.csv").read_text() == "name,value\na,1\nc,3\n"


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "name,value\na,1\nb\n", "\n"])
def test_a_foreign_table_is_refused(text: str, table: CsvTable, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SdfgcnError, match=r"a\.csv is not a table with the columns name,value"):
        table.read()
    with pytest.raises(SdfgcnError, match=r"a\.csv is not a table with the columns name,value"):
        table.append({"name": "a", "value": 1})
    assert (tmp_path / "a.csv").read_text() == text


# ------------------------------------------------------------------ configs


def test_differences_of_configs() -> None:
    before = flat({"a": 1, "b": {"c": [1], "d": None}})
    assert before == {"a": 1, "b.c": [1], "b.d": None}
    assert differences(before, before | {"b.e": None}) == ""
    now = {"a": 2, "b.c": [2], "b.e": 3}
    assert (
        differences(before, now, shown=2)
        == "a (1 there, 2 now), b.c ([1] there, [2] now) and 1 more"
    )
