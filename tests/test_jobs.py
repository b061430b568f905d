"""The queue of jobs in the store, and the runner that takes them: each ends once, and says why."""

import threading
import time

import pytest

from creak import jobs as running
from creak.jobs import JobRunner, arguments
from creak.sinks import jobs
from creak.sinks.jobs import JobStatus, Task

SECOND = 1_000_000_000
REPLAY = Task("replay", ("a.mcap",))


def put(store, task=REPLAY, now=0):
    return jobs.put(store, task, {"recording": "a"}, now=now, waiting=100)


def shown(store, identifier):
    with store.read() as connection:
        return jobs.job(connection, identifier)


def test_jobs_are_claimed_in_order_and_each_once(store):
    """Kills two runners that take the same job."""
    asked = [put(store) for _ in range(12)]
    taken, lock = [], threading.Lock()

    def take():
        while len(taken) < len(asked):
            claimed = jobs.claim(store, 1)
            if claimed is not None:
                with lock:
                    taken.append(claimed.id)

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert sorted(taken) == sorted(asked)
    assert jobs.claim(store, 2) is None
    first = put(store)
    put(store)
    assert jobs.claim(store, 3).id == first


def test_a_task_comes_back_as_it_was_put(store):
    task = Task("diagnosis", ("a.mcap", "b.mcap"), "model.toml", "other.mcap", 3, 7, ("0.mcap",), 1, 2)
    put(store, task)
    assert jobs.claim(store, 1).task == task


def test_a_full_queue_refuses(store):
    assert jobs.put(store, REPLAY, {}, now=0, waiting=1) is not None
    assert jobs.put(store, REPLAY, {}, now=0, waiting=1) is None


def test_a_job_whose_runner_fell_silent_has_failed(store):
    """Kills a job that runs for ever after the service was killed."""
    alive, dead = put(store), put(store)
    for _ in range(2):
        jobs.claim(store, 0)
    later = round(2 * jobs.SILENT_SECONDS * SECOND)
    assert jobs.beat(store, alive, later - SECOND, 0.5, "fitting")
    jobs.fail_orphans(store, later)
    assert (shown(store, alive)["status"], shown(store, alive)["progress"]) == ("running", 0.5)
    assert shown(store, dead)["status"] == "failed"
    assert "ask for it again" in shown(store, dead)["reason"]
    jobs.finish(store, dead, JobStatus.DONE, later, result="{}")  # its runner was only slow, and is too late
    assert shown(store, dead)["status"] == "failed"
    assert not jobs.beat(store, dead, later, 0.9, "late")


def test_cancelled_is_cancelled_whatever_comes_after(store):
    waiting, going = put(store), put(store)
    jobs.cancel(store, waiting, 1)
    assert shown(store, waiting)["status"] == "cancelled"
    assert jobs.claim(store, 2).id == going
    jobs.cancel(store, going, 3)
    assert shown(store, going)["status"] == "running"  # until its process has ended
    assert not jobs.beat(store, going, 4, None, "")
    jobs.finish(store, going, JobStatus.DONE, 5, result="{}")
    assert (shown(store, going)["status"], shown(store, going)["result"]) == ("cancelled", None)
    jobs.cancel(store, going, 6)
    assert shown(store, going)["ended_at"] == "1970-01-01T00:00:00.000000005Z"


def test_old_jobs_are_forgotten_with_their_reports(store):
    for number in range(5):
        identifier = put(store)
        jobs.claim(store, 1)
        jobs.finish(store, identifier, JobStatus.DONE, 2, result="{}", report=f"{number}.html")
    waiting = put(store)
    assert sorted(jobs.prune(store, kept=2)) == ["0.html", "1.html", "2.html"]
    with store.read() as connection:
        left = [item["report"] is not None for item in jobs.listed(connection, None, None, 10).items]
    assert left == [False, True, True]
    assert shown(store, waiting)["status"] == "queued"
    assert jobs.prune(store, kept=2) == []


def test_the_command_of_a_task(tmp_path):
    task = Task("diagnosis", ("-a.mcap", "b.mcap"), "model.toml", "other.mcap", 0, 7)
    assert arguments(task, tmp_path / "r.html") == [
        *("diagnose", "--json", "--model", "model.toml", "--report", str(tmp_path / "r.html")),
        *(
            "--validate",
            "other.mcap",
            "--first-realisation",
            "0",
            "--last-realisation",
            "7",
            "--",
            "-a.mcap",
            "b.mcap",
        ),
    ]
    assert arguments(REPLAY, None) == ["replay", "--json", "--", "a.mcap"]


# --- the runner ------------------------------------------------------------------------------------------------

ON_A_FILE = pytest.mark.parametrize("url", ["sqlite"], indirect=True)  # what it asks of the store is tested above


def ended(store, identifier, seconds=60):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        job = shown(store, identifier)
        if job["status"] not in {"queued", "running"}:
            return job
        time.sleep(0.02)
    return pytest.fail(f"job did not end: {shown(store, identifier)}")


@pytest.fixture
def runner(store, tmp_path):
    made = []

    def start(**options):
        made.append(JobRunner(store, tmp_path / "jobs", **options))
        made[-1].start()
        return made[-1]

    yield start
    for one in made:
        one.stop(5.0)


def sleeping(monkeypatch, seconds=600):
    """Jobs that do nothing but last, in place of the commands."""
    words = ["-c", f"import time; time.sleep({seconds})"]
    start = running.subprocess.Popen

    def popen(command, **options):
        return start([command[0], *words], **options)

    monkeypatch.setattr(running.subprocess, "Popen", popen)


@ON_A_FILE
def test_a_job_that_fails_says_why(store, runner):
    """Kills a runner that dies with a job, and a reason that nobody can read."""
    runner()
    first, second = (
        put(store, Task("replay", ("/nowhere/a.mcap",))),
        put(store, Task("replay", ("/nowhere/b.mcap",))),
    )
    job = ended(store, first)
    assert (job["status"], job["result"]) == ("failed", None)
    assert job["reason"].startswith("/nowhere/a.mcap: ")
    assert "\n" not in job["reason"]
    assert ended(store, second)["reason"].startswith("/nowhere/b.mcap: ")


@ON_A_FILE
def test_a_job_that_the_machine_cannot_run_fails_and_the_next_one_runs(store, runner, tmp_path, monkeypatch):
    """Kills a runner whose thread dies of a full disk: that job would be for ever running, all others waiting."""
    sleeping(monkeypatch)
    blocking = tmp_path / "jobs"  # where the runner wants its directory
    blocking.write_text("")
    runner()
    job = ended(store, put(store))
    assert (job["status"], job["reason"]) == ("failed", "it cannot be run here: File exists")
    blocking.unlink()
    second = put(store)
    end = time.monotonic() + 10
    while shown(store, second)["status"] != "running":
        assert time.monotonic() < end
        time.sleep(0.01)


@ON_A_FILE
def test_a_running_job_is_cancelled_and_the_next_one_runs(store, runner, monkeypatch):
    sleeping(monkeypatch)
    runner()
    first = put(store)
    while shown(store, first)["status"] != "running":
        time.sleep(0.01)
    jobs.cancel(store, first, time.time_ns())
    assert ended(store, first, 10)["status"] == "cancelled"


@ON_A_FILE
def test_a_job_that_takes_too_long_is_ended(store, runner, monkeypatch):
    sleeping(monkeypatch)
    runner(max_seconds=0.5)
    assert ended(store, put(store), 10)["reason"] == "it took longer than 0.5 s"


@ON_A_FILE
def test_a_service_that_ends_takes_its_jobs_along(store, runner, monkeypatch):
    """Kills a process that goes on after the service, and a job that is for ever running."""
    sleeping(monkeypatch)
    one = runner()
    first, second = put(store), put(store)
    while shown(store, first)["status"] != "running":
        time.sleep(0.01)
    began = time.monotonic()
    one.stop(5.0)
    assert time.monotonic() - began < 3
    assert "stopped" in shown(store, first)["reason"]
    assert shown(store, second)["status"] == "queued"  # for the service that comes after it
