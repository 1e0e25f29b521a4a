"""A whole study on Dask workers: results and tables, and what is left where a process is killed."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import distributed
import psutil
import pyarrow.parquet as pq
import pytest
import study_work
from distributed.comm.core import connect

from fgpose.study import Plan, RecordingOutcome, StudyResult, cluster, load_study, process, run_study
from fgpose.study.cluster import SchedulerLostError, Stream, workers
from fgpose.study.study import Resources, StudyDescription

ROOT = Path(__file__).parents[3]
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "factors")))}
# Dask's own, at exit.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore:unclosed:ResourceWarning")


def contents(folder: Path) -> dict[str, bytes]:
    """Of all results but tables, by their paths; times of files are not results."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for name in ("recordings", "motion")
        for file in sorted((folder / name).rglob("*"))
        if file.is_file() and file.name != "state.json"
    }


EVENTS = "subject\ttrial\tevent\ttime_s\tside\nS01\trun\tgo\t0.1\tleft\nS02\trun\tgo\t0.2\tright\nS09\trun\tgo\t0.1\t\n"
LATE = "S02\twalk\tlate\t99\t\nS02\twalk\tend\t0.33\t\n"


@pytest.fixture(scope="module")
def client() -> Iterator[distributed.Client]:
    """Two workers for several tests: to start them takes longer than what they do."""
    with workers(Resources(workers=2)) as client:
        yield client


def run_with(client: distributed.Client, study: StudyDescription, **options: Any) -> StudyResult:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fgpose.study.run.workers", lambda resources, scheduler: nullcontext(client))
        return run_study(study, **options)


@pytest.fixture(scope="module")
def finished(
    client: distributed.Client, study_source: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, StudyResult]:
    """Of the four recordings one is truncated, one a copy, and one has no calibration."""
    folder = tmp_path_factory.mktemp("finished") / "data"
    shutil.copytree(study_source, folder)
    walk = folder / "S01" / "A" / "walk.npz"
    walk.write_bytes(walk.read_bytes()[:500])
    shutil.copy(folder / "S01" / "A" / "run.npz", folder / "S02" / "A" / "run.npz")
    (folder / "S03" / "A").mkdir(parents=True)
    shutil.copy(folder / "S02" / "A" / "walk.npz", folder / "S03" / "A" / "walk.npz")
    (folder / "events.tsv").write_text(EVENTS + LATE)
    file = folder / "study.toml"
    file.write_text(file.read_text().replace("[steps]", 'events = "events.tsv"\n[steps]'))
    return file, run_with(client, load_study(file))


def test_what_fails_is_named_and_the_rest_is_done(finished: tuple[Path, StudyResult]) -> None:
    file, result = finished
    assert result.counts == {"done": 3, "failed": 2}
    reasons = dict(result.failures)
    assert "a damaged npz" in reasons["S01/A/walk"]
    assert "it has no calibration: there is no S03/A/Calib.toml" in reasons["S03/A/walk"]
    assert result.notes == [
        "events.tsv: there is no recording S09/run",
        "events.tsv: late at 99 s is outside of S02/A/walk, which lasts from 0 to 0.3 s",
    ]
    assert {path.name for path in result.written} == {"quality.csv", "quality.parquet", "events.parquet"}
    assert load_study(file).output == result.output


def test_the_table_of_quality(finished: tuple[Path, StudyResult]) -> None:
    _, result = finished
    table = pq.read_table(result.output / "quality.parquet")
    assert table.schema.metadata == {b"fgpose.study": b"study", b"fgpose.world_up": b"auto"}
    rows = {row["recording"]: row for row in table.to_pylist()}
    assert {key: row["status"] for key, row in rows.items()} == {
        "S01/A/run": "done",
        "S01/A/walk": "failed",
        "S02/A/run": "done",
        "S02/A/walk": "done",
        "S03/A/walk": "failed",
    }
    assert rows["S02/A/run"]["same_as"] == "S01/A/run"
    assert rows["S02/A/walk"]["same_as"] == ""
    assert rows["S02/A/walk"]["n_frames"] == 10
    assert rows["S02/A/walk"]["seen_share"] == 1.0
    assert rows["S01/A/walk"]["n_frames"] is None
    header, *lines = (result.output / "quality.csv").read_text().splitlines()
    assert (header[:55], len(lines)) == ("recording,subject,session,trial,status,reason,n_people,", len(rows))


def test_events_have_their_recordings(finished: tuple[Path, StudyResult]) -> None:
    rows = pq.read_table(finished[1].output / "events.parquet").to_pylist()
    assert [(row["recording"], row["time_s"], row["side"]) for row in rows] == [
        ("S01/A/run", 0.1, "left"),
        ("S02/A/run", 0.2, "right"),
        ("S02/A/walk", 99.0, ""),
        ("S02/A/walk", 0.33, ""),
    ]


def by_pandas(folder: Path) -> dict[str, int]:
    import pandas

    table = pandas.read_parquet(folder)
    assert {"subject", "session", "x_m", "joint"} <= set(table.columns)
    return table.groupby("recording").size().to_dict()


def by_polars(folder: Path) -> dict[str, int]:
    polars = pytest.importorskip("polars")
    table = polars.read_parquet(folder, hive_partitioning=True)
    assert table["subject"].unique().sort().to_list() == ["S01", "S02"]
    return dict(table.group_by("recording").len().iter_rows())


def by_duckdb(folder: Path) -> dict[str, int]:
    duckdb = pytest.importorskip("duckdb")
    query = (
        f"SELECT recording, count(*) FROM read_parquet('{folder}/**/*.parquet') WHERE session = 'A' GROUP BY recording"
    )
    return dict(duckdb.sql(query).fetchall())


@pytest.mark.parametrize("opened", [by_pandas, by_polars, by_duckdb])
def test_the_data_set_opens_as_one_table(
    finished: tuple[Path, StudyResult], opened: Callable[[Path], dict[str, int]]
) -> None:
    # 10 frames of 17 joints
    assert opened(finished[1].output / "motion") == dict.fromkeys(("S01/A/run", "S02/A/run", "S02/A/walk"), 170)


@pytest.mark.slow
def test_results_are_the_same_in_any_order(finished: tuple[Path, StudyResult], tmp_path: Path) -> None:
    file, result = finished
    shutil.copytree(file.parent, tmp_path / "data", ignore=shutil.ignore_patterns("results"))
    study = load_study(tmp_path / "data" / "study.toml")
    outcomes = [process(study, recording) for recording in reversed(list(Plan(study)))]
    assert sum(outcome.status == "done" for outcome in outcomes) == 3
    expected = contents(result.output)
    found = contents(study.output)
    notes = {name for name in found if name.endswith(".failed.txt")}
    assert {name: found[name] for name in found if name not in notes} == {
        name: expected[name] for name in expected if name not in notes
    }
    assert len(found) - len(notes) == 6


def test_parts_of_what_is_gone_are_removed(
    finished: tuple[Path, StudyResult], client: distributed.Client, tmp_path: Path
) -> None:
    shutil.copytree(finished[0].parent, tmp_path / "data")
    study = load_study(tmp_path / "data" / "study.toml")
    study = replace(study, data=replace(study.data, events=""))
    (study.root / "S02" / "A" / "walk.npz").unlink()
    (study.root / "S01" / "A" / "run.npz").write_bytes(b"")
    result = run_with(client, study)
    assert result.counts == {"unchanged": 1, "failed": 3}
    assert [file.name for file in (study.output / "motion").rglob("*.parquet")] == ["run.parquet"]
    assert not (study.output / "events.parquet").exists()


def test_a_scheduler_that_does_not_answer_is_an_error(study_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_ANSWERS_WITHIN_S", 0.5)
    with pytest.raises(OSError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9 within 0\.5 s"):
        run_study(load_study(study_file), scheduler="tcp://127.0.0.1:9")
    with pytest.raises(OSError, match="no scheduler answers at nonsense://x"):
        run_study(load_study(study_file), scheduler="nonsense://x")


def test_two_studies_do_not_write_into_one_folder(study_file: Path, client: distributed.Client) -> None:
    study = load_study(study_file)

    def run_again(outcome: RecordingOutcome) -> None:
        with pytest.raises(OSError, match="another fgpose study is at work"):
            run_study(study)

    assert run_with(client, study, only="S01/A/run", on_outcome=run_again).counts == {"done": 1}
    rows = pq.read_table(study.output / "quality.parquet")["status"].to_pylist()
    assert rows == ["done", "not done", "not done", "not done"]


def test_another_user_of_the_machine_does_not_reach_the_workers(client: distributed.Client) -> None:
    """Whoever reaches a scheduler or a worker runs code as the one who began the study."""
    served = [cast(Any, client.scheduler).address, next(iter(cast(dict[str, int], client.nthreads())))]
    assert all(address.startswith("tls://127.0.0.1:") for address in served)
    for address in served:
        plain = address.replace("tls:", "tcp:")
        others = distributed.Security(), distributed.Security.temporary()
        for address_tried, credentials in zip((plain, address), others, strict=True):
            # Without the threads of a client, which may begin too late for it on a busy machine.
            arguments = credentials.get_connection_args("client")
            with pytest.raises(OSError, match=r"TLS|imed out|reset|losed"):
                asyncio.run(connect(address_tried, timeout=0.5, **arguments))


def test_a_worker_that_dies_is_replaced_and_its_recording_tried_once_more(
    study_file: Path, client: distributed.Client
) -> None:
    study = load_study(study_file)
    study.output.mkdir()
    outcomes = list(Stream(client, study, iter(Plan(study)), study_work.dies_at_walks).outcomes())
    statuses = {outcome.recording.key: outcome.status for outcome in outcomes}
    assert statuses == {"S01/A/run": "done", "S01/A/walk": "failed", "S02/A/run": "done", "S02/A/walk": "done"}
    (reason,) = (outcome.reason for outcome in outcomes if outcome.status == "failed")
    assert "its worker died" in reason
    tried = {path.name: len(path.read_text().splitlines()) for path in study.output.iterdir() if path.is_file()}
    # Another that was at the worker that died is tried once more as well.
    assert tried.pop("S01_walk") == 2
    assert tried.keys() == {"S01_run", "S02_run", "S02_walk"}
    assert max(tried.values()) <= 2


def test_a_lock_that_leads_elsewhere_empties_nothing(study_file: Path, tmp_path: Path) -> None:
    """A study from somebody else can have a link to any file where the lock would be."""
    study, other = load_study(study_file), tmp_path / "thesis.txt"
    other.write_text("all my work")
    study.output.mkdir()
    (study.output / ".lock").symlink_to(other)
    with pytest.raises(OSError, match=r"cannot lock .*\.lock"):
        run_study(study, n_workers=1)
    assert other.read_text() == "all my work"


@pytest.mark.parametrize(
    "name", ["recordings", "recordings/S01", "recordings/S01/run/motion.parquet", "motion", "quality.csv"]
)
def test_results_are_not_written_through_a_link(
    name: str, study_file: Path, client: distributed.Client, tmp_path: Path
) -> None:
    study, elsewhere = load_study(study_file), tmp_path / "elsewhere"
    elsewhere.mkdir()
    link = study.output / name
    link.parent.mkdir(parents=True)
    link.symlink_to(elsewhere)
    with pytest.raises(OSError, match=rf"{link} is a link, to {elsewhere}: results of a study are"):
        run_with(client, study)
    assert list(elsewhere.iterdir()) == []


@pytest.mark.slow
def test_a_folder_of_results_that_leads_out_of_the_study_is_refused(study_file: Path, tmp_path: Path) -> None:
    study = load_study(study_file)
    (tmp_path / "elsewhere").mkdir()
    study.output.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="outside of the folder of the study: if results belong there"):
        run_study(study, n_workers=1)
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.slow
def test_studies_at_one_time_do_not_need_one_port() -> None:
    one = Resources(workers=1)
    with workers(one) as first, workers(one) as second:
        # A client that is used with await would give coroutines here.
        assert [len(cast(dict[str, int], client.nthreads())) for client in (first, second)] == [1, 1]


@contextmanager
def started(*command: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, "-m", *command],
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        **options,
    )
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def waited_for(done: Callable[[], bool]) -> None:
    for _ in range(600):
        if done():
            return
        time.sleep(0.1)
    raise AssertionError("a minute is enough for ten frames")


@pytest.mark.slow
def test_a_killed_scheduler_loses_nothing_finished(study_file: Path, tmp_path: Path) -> None:
    study, file = load_study(study_file), tmp_path / "scheduler.json"
    scheduler = ("distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(file), "--no-dashboard")
    worker = ("distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard")
    with started(*scheduler) as at_work, started(*worker, "--death-timeout", "30"):
        waited_for(file.exists)
        address = json_address(file)
        outcomes = []

        def kill(outcome: RecordingOutcome) -> None:
            outcomes.append(outcome.status)
            if len(outcomes) == 2:
                at_work.kill()

        with pytest.raises(SchedulerLostError, match="the scheduler has gone"):
            run_study(study, scheduler=address, on_outcome=kill)
    assert pq.read_table(study.output / "quality.parquet")["status"].to_pylist().count("done") >= 2
    again = run_study(study, n_workers=1)
    assert again.counts["unchanged"] >= 2
    assert again.counts.total() == 4


def json_address(file: Path) -> str:
    import json

    return json.loads(file.read_text())["address"]


@pytest.mark.slow
def test_kill_9_loses_what_is_at_hand_at_most(study_file: Path) -> None:
    study = load_study(study_file)
    with started("fgpose", "study", str(study_file), "--workers", "1") as at_work:
        waited_for(lambda: any(study.output.rglob("state.json")))
        children = psutil.Process(at_work.pid).children(recursive=True)
        at_work.send_signal(signal.SIGKILL)
        at_work.wait()
    # Workers end when their parent does.
    assert not psutil.wait_procs(children, timeout=30)[1]
    n_finished = sum(1 for _ in study.output.rglob("recordings/*/*/[a-z]*/state.json"))
    again = run_study(study, n_workers=1)
    assert again.counts == {"unchanged": n_finished, "done": 4 - n_finished}
    assert n_finished >= 1
