"""How far the gain may go against the sampling time, with a transport delay and a velocity servo in the loop."""

import numpy as np

from clikgen.analysis.clik_loop import Loop, closed_loop, gain_bound, margins, ramp_lag
from clikgen.analysis.discrete_filter import beta_of

print("T [ms]   no filter   A: f_c = 4 Hz   A, 1 sample of delay and a 20 ms servo")
for T in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05):
    beta = beta_of(4.0, T)
    bounds = [gain_bound(Loop("A", T)), gain_bound(Loop("A", T, beta)), gain_bound(Loop("A", T, beta, 1, 0.02))]
    print(f"{1e3 * T:6g}" + "".join(f"{bound:13.4g}" for bound in bounds))

loop = Loop("A", 0.01, beta_of(4.0, 0.01))
print(margins(loop, 4.0))
print(f"a ramp is followed {ramp_lag(loop, 4.0):.3f} s late; closed-loop poles {closed_loop(loop, 4.0).poles()}")
print(f"the unfiltered bound is 2/T: {np.isclose(gain_bound(Loop('A', 0.01)), 200)}")
