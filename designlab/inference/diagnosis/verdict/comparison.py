"""The shots that pictures of a diagnosis show, beside what the models predict of them."""

from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Prediction, PressComparison, ShotComparison
from designlab.inference.diagnosis.selection.held_out import squared
from designlab.inference.diagnosis.verdict.localise import geometry
from designlab.simulation.render_cache import Renders


def compared(source: Renders, given: tuple[Fitter, State], updated: tuple[Fitter, State]) -> PressComparison:
    """Compare the final press that the model as given misses by most, and the untouched gel.

    Parameters
    ----------
    source : Renders
        Where pictures come from.
    given, updated : tuple of Fitter and State
        The model as given and the updated one; the latter is left out where nothing was added.
    """
    fitter, state = given
    shots = fitter.bank.shots
    final = [n for n, shot in enumerate(shots) if shot.use == "final"]
    worst = max(final, key=lambda n: squared(fitter, state, n)[0])
    untouched = [n for n, shot in enumerate(shots) if shot.press is None and not shot.gel_rotation_deg]
    brightest = max(untouched, key=lambda n: float(shots[n].lit.sum()))
    models = {"as given": given} | ({"updated": updated} if updated[1].values else {})

    def beside(number: int) -> ShotComparison:
        predicted = {name: _predicted(*model, number) for name, model in models.items()}
        return ShotComparison(shots[number], predicted)

    contact = geometry(fitter, source, state, worst).contact
    x_mm, y_mm = geometry(fitter, source, state, brightest).seen_mm
    return PressComparison(beside(worst), beside(brightest), contact, x_mm, y_mm, fitter.forward.design)


def _predicted(fitter: Fitter, state: State, number: int) -> Prediction:
    noise = fitter.noises[number]
    return Prediction(fitter.forward.predict(state, number), noise.sigma, noise.granted)
