"""Where fits begin: of every effect that blind trials hide, what its first guesses foretell and come to.

    python benchmarks/guesses.py FOLDER [--first 0] [--last 100]

FOLDER is one of `dipc-gym trial` whose answers are no secret any more. Each hidden effect is asked for alone, at its
place, beside the refitted model, as a search asks in its first round: an effect that is there and has no guess, or
whose fit leaves nearly all of the error, is one that a search hardly finds, whatever it decides by. The weaker one of
a pair may leave most of it; what happened once, and what goes by the clock, is asked for in later rounds alone. Trials
whose refitted model is at the noise are left out. Errors are those of windows, in multiples of the noise.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from dipc_gym import mjcf, recording
from dipc_gym.sim2real.diagnosis import begin_search
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.model.structure import carry
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.hypotheses import Phase, hypotheses
from dipc_gym.sim2real.selection.screen import LaidOver
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict.withheld import gather

STEPS = 25  # of a fit: as many as a search gives a full one
AT_NOISE = 1.3  # times it, from which on there is something to find


def rows(folder, answer):
    """A line of the table for each effect that a trial hides."""
    place = folder / "trials" / answer["trial"]
    model = place / "nominal.xml"
    compiled = mjcf.compile(model)
    runs = [recording.read(path, compiled) for path in sorted(place.glob("train_*.csv"))]
    case = part(gather(mjcf.read(model), runs, (), Wishes())[0], threads=1)
    search, _ = begin_search(case, baseline(case), list(catalogue().values()), Stop(lambda line: None))
    current, fitter = search.progress.current, search.fitter
    if current.error < AT_NOISE:
        return
    laid_over = LaidOver(fitter.problem, current, fitter.subset)
    scene = replace(search.question.look(current), fitted=(fitter.problem.windows, current))
    for hidden in answer["missing"]:
        effect = catalogue().get(hidden["effect"])
        if effect is None or effect.once or effect.of_the_clock:
            continue
        places = (hidden["at"], *hidden["also_at"])
        phase = Phase.SHAPES if effect.free else Phase.FORMULAS
        asked = hypotheses(replace(search.question, effects=[effect]), phase, current, scene)
        tried = laid_over.tried([one for guesses in asked for one in guesses() if one.at in places])
        gain, after = "none", current.error
        if tried:
            best = max(tried, key=lambda one: one.predicted_gain)
            structure = current.structure.with_term(best.term)
            begin = carry(current.structure, current.z, structure)
            gain = f"{best.predicted_gain:.2f}"
            after = fit(fitter.problem, structure, begin, current.initial, most=STEPS).error
        yield [answer["trial"], f"`{hidden['effect']}`", len(tried), gain, f"{current.error:.3g}", f"{after:.3g}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of a blind trial, with its sealed answers")
    parser.add_argument("--first", type=int, default=0, help="trial to begin with (default 0)")
    parser.add_argument("--last", type=int, default=None, help="trial to end before (default: all)")
    given = parser.parse_args()
    answers = [json.loads(path.read_text()) for path in sorted((given.folder / "sealed").glob("*.json"))]
    answers = [one for one in answers if one.get("missing")]
    if not answers:
        parser.error(f"{given.folder} holds no sealed answers of a trial that hides something")
    print("| trial | hidden | guesses | gain foretold | refitted | with it |")
    print("|---" * 6 + "|")
    shares = []
    for answer in answers[given.first : given.last]:
        for row in rows(given.folder, answer):
            shares.append(float(row[-1]) / float(row[-2]))
            print("| " + " | ".join(map(str, row)) + " |", flush=True)
    if shares:
        print(
            f"\nOf {len(shares)} effects {np.sum(np.array(shares) > 0.9)} leave nine tenths or more of the error alone."
        )


if __name__ == "__main__":
    main()
