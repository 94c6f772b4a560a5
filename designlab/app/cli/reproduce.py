"""Command reproduce: the paper's experiments on made sensors, and its figures beside ours."""

from argparse import Namespace

from designlab.app.cli.console import Result
from designlab.core.progress import IN_PERCENT, bar


def reproduce(args: Namespace) -> Result:
    """Run what is left of the experiments, and write the pages about them."""
    from designlab.validation.paper_2020.run import reproduce as run

    with bar(form=IN_PERCENT) as progress:
        done = run(args.out, size=args.size, seed=args.seed, progress=progress)
    lines = [f"report    {done['report']}", f"markdown  {done['markdown']}", f"figures   {done['result']}"]
    left_out = [found["left_out"] for found in done["stages"].values() if "left_out" in found]
    return Result(done, "\n".join([*lines, *(f"real picture {text}" for text in left_out)]))
