"""Plays up to a million steps on pip's gfootball and on ours, and compares all that was to be seen.

    python engine/tests/compare_engines.py --reference build/default-engine --out DIRECTORY

Each side is recorded shard by shard into files of DIRECTORY, and an interrupted recording goes on
where it was: a shard that was begun is played again. `--only reference` and `--only engine` record
one side, `--only compare` compares what both have. Exit code 0: that is equal; 1: it differs; 2: a
side could not be recorded.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from comparison import Table, first_differing_step
from engine_process import EnginePlayError, play
from million import STEPS_PER_ROUND, Shard, shards

SIDES = ("reference", "engine")


def read_shard(path: Path) -> list[dict[str, Any]] | None:
    """The episodes of a shard; None while it has not been recorded to its end."""
    if not path.exists():
        return None
    lines = [json.loads(line) for line in path.read_text().splitlines() if line.endswith("}")]
    if not lines or "done" not in lines[-1]:
        return None
    return [line for line in lines if "scenario" in line]


def record_shard(shard: Shard, engine: Path | None, path: Path) -> int:
    """Plays a shard into its file, line by line; how many steps it has."""
    with path.open("w") as file:
        for line in play(engine, shard.episodes(), "--steps", str(shard.steps)):
            file.write(json.dumps(line) + "\n")
            file.flush()
    return int(line["done"])


def record(side: Path, engine: Path | None, wanted: list[Shard], processes: int) -> None:
    """Records what a side lacks.

    Args:
        side: The folder of its files.
        engine: Where its engine is; None for the installed one.
        wanted: The shards, in order.
        processes: How many play at a time.

    Raises:
        EnginePlayError: A shard could not be played to its end.
    """
    side.mkdir(parents=True, exist_ok=True)
    paths = {shard: side / f"{shard.name}.jsonl" for shard in wanted}
    missing = [shard for shard in wanted if read_shard(paths[shard]) is None]
    there = len(wanted) - len(missing)
    print(f"{side.name}: {there} of {len(wanted)} shards are there", flush=True)
    with ThreadPoolExecutor(processes) as pool:
        futures = {
            pool.submit(record_shard, shard, engine, paths[shard]): shard for shard in missing
        }
        try:
            for number, future in enumerate(as_completed(futures), there + 1):
                name = futures[future].name
                print(
                    f"{side.name}: {name}, {future.result()} steps, {number} of {len(wanted)}",
                    flush=True,
                )
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def compare(out: Path, wanted: list[Shard]) -> Table:
    """Compares the shards that both sides have."""
    table = Table()
    for shard in wanted:
        path = f"{shard.name}.jsonl"
        reference, engine = (read_shard(out / side / path) for side in SIDES)
        if reference is not None and engine is not None:
            table.add(shard, reference, engine)
    return table


def _main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000, help="rounded up to 50,000")
    parser.add_argument("--reference", type=Path, help="directory of gfootball as pip builds it")
    parser.add_argument("--engine", type=Path, help="directory of ours; default: the installed one")
    parser.add_argument("--out", type=Path, required=True, help="directory of the recordings")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", choices=(*SIDES, "compare"), help="do nothing but this")
    arguments = parser.parse_args()
    wanted = list(shards(-(-arguments.steps // STEPS_PER_ROUND)))
    engines = {side: getattr(arguments, side) for side in SIDES}
    try:
        for side, engine in engines.items():
            if arguments.only in (None, side):
                record(arguments.out / side, engine, wanted, arguments.processes)
        if arguments.only in SIDES:
            return
        table = compare(arguments.out, wanted)
        print(*table.lines(), sep="\n")
        print(*table.differences, sep="\n")
        if table.differences:
            first = table.differences[0]
            print(f"{first}: from", first_differing_step(first, **engines))
            sys.exit(1)
    except EnginePlayError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    _main()
