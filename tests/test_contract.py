"""The project fits its budget, and tests enter it by the faces of its rooms."""

from importlib import import_module

from tests.budget import over_budget, spent
from tests.faces import FACES, ROOT, trespasses


def test_every_line_of_the_budget_holds():
    assert over_budget(ROOT, *spent(ROOT)) == []


def test_tests_and_examples_enter_by_the_faces_as_far_as_before():
    assert len(trespasses(ROOT)) <= FACES["trespasses"]


def test_a_room_has_few_public_names_and_its_readme_states_each():
    for room, modules in FACES["faces"].items():
        readme = (ROOT / room / "README.md").read_text(encoding="utf-8")
        names = [(module, name) for module, listed in modules.items() for name in listed]
        assert len({name for _, name in names if not name.endswith("Error")}) <= 20, room
        for module, name in names:
            assert hasattr(import_module(module), name), (module, name)
            assert f"`{name}`" in readme, (room, name)
