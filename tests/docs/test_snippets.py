"""Every command and every piece of code of the documentation and of the README works, or at least parses."""

from __future__ import annotations

import re
import shutil
import warnings
from pathlib import Path

import jaxtyping
import pytest

from tests.docs import snippets
from tests.docs.sandbox import make_sandbox

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")], key=lambda path: path.relative_to(ROOT).as_posix())
# Included in the site as they are. Their commands measure for minutes and hours, or are those of this test itself.
ONLY_CHECKED = (ROOT / "benchmarks" / "README.md", ROOT / "CONTRIBUTING.md")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def with_code(paths: list[Path]) -> list[Path]:
    return [path for path in paths if snippets.languages(path.read_text(encoding="utf-8"))]


@pytest.fixture(scope="session")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sandbox")
    make_sandbox(folder)
    return folder


@pytest.fixture
def work(sandbox: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files of the documentation, in which the commands are run."""
    folder = tmp_path / "work"
    shutil.copytree(sandbox, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("FGPOSE_CAM01_PASSWORD", "secret")
    # As who reads it runs it: the checks of the tests take 60 for no float, and the name of a skeleton for no skeleton.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", with_code(PAGES), ids=name_of)
@pytest.mark.usefixtures("work")
def test_what_a_page_shows_works(page: Path) -> None:
    examples = list(snippets.parsed(page).examples())
    assert examples
    with warnings.catch_warnings():
        # Of recordings of a second, in which a camera that was moved is part of the story.
        warnings.simplefilter("ignore", UserWarning)
        for example in examples:
            example.evaluate()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_of_code_has_a_language_that_is_checked(page: Path) -> None:
    languages = snippets.languages(page.read_text(encoding="utf-8"))
    assert set(languages) <= {"bash", "python", "toml"}
    # What Sybil finds is run. Those in comments of the page are Sybil's alone.
    assert len(list(snippets.parsed(page).examples())) >= len(languages)


@pytest.mark.parametrize("page", ONLY_CHECKED, ids=name_of)
def test_commands_that_take_long_name_what_exists(page: Path) -> None:
    blocks = re.findall(r"```bash\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for block in blocks:
        for words in snippets.commands(block):
            snippets.check_command(words, is_run=False)


def test_no_command_hides_in_an_indented_block() -> None:
    for page in [*PAGES, *ONLY_CHECKED]:
        outside = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        assert not re.search(r"\n\n {4}(fgpose|make|python|pip)\b", outside), page


def test_what_is_not_run_says_why_in_a_word() -> None:
    for page in PAGES:
        for example in snippets.parsed(page).examples():
            reason = snippets.reason_not_to_run(example)
            for named in re.findall(r"tests/[\w/.]+\.py", reason):
                assert (ROOT / named).is_file(), f"{page}: {named}"


def test_a_wrong_command_is_noticed() -> None:
    with pytest.raises(SystemExit):
        snippets.check_command(["fgpose", "smooth", "pose/", "--no-such-option"], is_run=False)
    with pytest.raises(AssertionError):
        snippets.check_command(["make", "no-such-target"], is_run=False)
    with pytest.raises(AssertionError):
        snippets.check_command(["pip", "install", "fgpose[nothing]"], is_run=False)
    with pytest.raises(AssertionError, match="nobody checks"):
        snippets.check_command(["rosrun", "fgpose"], is_run=True)
