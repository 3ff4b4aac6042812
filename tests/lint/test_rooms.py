"""The house has no circle of imports and no crowded floor; what circles are is known from one made here."""

from tests.lint.rooms import circles, floors, modules, rooms

MOST = 15


def test_rooms_modules_and_rooms_import_one_another_in_no_circle() -> None:
    graph = modules()
    assert circles(graph) == []
    assert circles(rooms(graph, 2)) == []
    assert circles(rooms(graph, 3)) == []
    assert circles(rooms(graph, 4)) == []


def test_rooms_floors_hold_no_more_files_than_a_reader_keeps_in_mind() -> None:
    assert {room: files for room, files in floors().items() if files > MOST} == {}


def test_rooms_a_circle_is_found_whole() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set[str]()}
    assert circles(graph) == [["a", "b", "c"]]
