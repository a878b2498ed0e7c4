"""Campaigns on several engines: one table."""

import concurrent.futures
import json
import multiprocessing
import os
import signal
import subprocess

import pytest

import needle_steer as ns

CLI = os.environ.get("NEEDLE_STEER_CLI")
PLAN = {
    "laws": ["tip-only", "none"],
    "seeds": {"first": 41, "count": 3},
    "target": [{"depth_mm": 10.0, "offset_mm": 0.5}],
    "config": {"run": {"sensor": "shape"}, "phantom": {"needle": {"elements": 63}}},
}


@pytest.fixture(scope="module")
def here():
    return ns.campaign(PLAN, jobs=1)


def test_a_campaign_counts_concludes_and_saves(here, tmp_path):
    assert len(here.rows) == 6 and [row["run"] for row in here.rows] == list(range(6))
    assert here.table.count("\n") == 7
    assert {cell["law"] for cell in here.conclusions["cells"]} == {"tip-only", "none"}
    here.save(tmp_path / "table.csv")
    with pytest.raises(FileExistsError):
        here.save(tmp_path / "table.csv")


@pytest.mark.skipif(not CLI, reason="NEEDLE_STEER_CLI names no command")
def test_the_table_is_the_command_lines(here, tmp_path):
    file = tmp_path / "campaign.toml"
    file.write_text(ns._core.campaign_plan(PLAN)[0])
    subprocess.run([CLI, "campaign", file, "--out", tmp_path / "out"], check=True)
    assert (tmp_path / "out" / "results.csv").read_text() == here.table
    assert json.loads((tmp_path / "out" / "conclusions.json").read_text()) == here.conclusions
    assert ns.campaign(file).table == here.table


def test_executors_give_the_same_table(here):
    steps = []

    class Meter:
        def __init__(self, total, unit):
            assert total == 6

        def update(self, n):
            steps.append(n)

        def close(self):
            pass

    with concurrent.futures.ThreadPoolExecutor(2) as executor:
        assert ns.campaign(PLAN, executor, progress=Meter).table == here.table
    assert len(steps) == 6
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(2, mp_context=context) as executor:
        assert ns.campaign(PLAN, executor).table == here.table


def test_a_lost_worker_costs_only_its_runs(here):
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as executor:
        worker = executor.submit(os.getpid).result()

        class Meter:
            def __init__(self, **_):
                self.lost = False

            def update(self, n):
                if not self.lost:
                    self.lost = True
                    os.kill(worker, signal.SIGKILL)

            def close(self):
                pass

        assert ns.campaign(PLAN, executor, progress=Meter).table == here.table


def grandchildren(name):
    """Processes of that name whose parent's parent is this one."""

    def parent(pid):
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return int(file.read().rpartition(")")[2].split()[1])

    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", encoding="utf-8") as file:
                is_named = file.read().startswith(name)
            if is_named and parent(parent(pid)) == os.getpid():
                found.append(int(pid))
        except (OSError, ValueError):
            continue  # it has ended
    return found


def test_a_campaign_on_ray_survives_a_worker(tmp_path):
    ray = pytest.importorskip("ray")
    plan = {**PLAN, "seeds": {"first": 41, "count": 100}}
    killed = []

    class Meter:
        """Half-way it kills a worker at work."""

        def __init__(self, total, unit):
            self.left = total
            self.half = total // 2

        def update(self, n):
            self.left -= n
            if self.left <= self.half and not killed:
                killed.extend(grandchildren("ray::_one")[:1])
                for worker in killed:
                    os.kill(worker, signal.SIGKILL)

        def close(self):
            assert self.left == 0

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    try:
        table = ns.campaign(plan, "ray", progress=Meter).table
    finally:
        ray.shutdown()
    assert len(killed) == 1 and table.count("\n") == 201
    if not CLI:
        assert table == ns.campaign(plan).table
        return
    file = tmp_path / "campaign.toml"
    file.write_text(ns._core.campaign_plan(plan)[0])
    subprocess.run([CLI, "campaign", file, "--out", tmp_path / "out"], check=True)
    assert (tmp_path / "out" / "results.csv").read_text() == table


def test_plans_that_are_none_are_named(tmp_path):
    with pytest.raises(ns.InputError, match="laws"):
        ns.campaign({**PLAN, "laws": []})
    with pytest.raises(ns.InputError, match="none.toml: cannot be read"):
        ns.campaign(tmp_path / "none.toml")
    with pytest.raises(ns.InputError, match="executor"):
        ns.campaign(PLAN, 17)
    with pytest.raises(ns.InputError, match="expected \"ray\""):
        ns.campaign(PLAN, "slurm")
