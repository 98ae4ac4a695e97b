"""What the paper's scenario will do at the obstacle, from the compiled controller alone, and what it then did."""

from clikgen.analysis.chatter import compare, contact_in, predict
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare

controller = CompiledController.load("planar5")
scenario = read_scenario(find_scenario("paper"))

for case in CASES.values():
    rollout = prepare(controller, scenario, case).in_c()
    at = contact_in(controller, rollout, step=int(rollout.active.argmax()) + 30, point="tool")
    foreseen = predict(at.map)
    print(f"Case {case.number}: a = {at.map.a:.3f}, b = {1e3 * at.map.b:.2f} mm, c = {1e3 * at.map.c:.4f} mm")
    print(f"  at one state the normal map predicts: {foreseen.regime}, every {foreseen.period.mean:.3g} samples")
    for one in compare(controller, rollout):
        measured, predicted = one.measured, one.prediction
        print(
            f"  {measured.points[0]}: predicted {predicted.regime}, {predicted.period.mean:.3g} samples; "
            f"measured {measured.regime}, {measured.period.mean:.3g} samples, {1e3 * measured.amplitude.mean:.2f} mm"
        )
