"""The filter that planar5 ships: designed in hertz, its Bode plot with the compiled step's response on it."""

from pathlib import Path

from clikgen.analysis.discrete_filter import beta_for, cutoff_of, system
from clikgen.analysis.filter_figures import filter_plates
from clikgen.analysis.measured_filter import measure_response
from clikgen.analysis.plates import save_plates
from clikgen.runtime.controller import CompiledController

T = 0.01  # [s]
wanted = 3.0  # [Hz], the true −3 dB frequency

beta = beta_for(wanted, T)
print(f"β = {beta:.4f}; write cutoff = {cutoff_of(beta, T):.4f} in the spec's [filter]")
print(system(beta, T))  # a python-control system, to go on from

controller = CompiledController.load("planar5")
measured = measure_response(controller, cutoff=cutoff_of(beta, T), period=T)
print(*save_plates(filter_plates([measured]), Path("results")), sep="\n")
