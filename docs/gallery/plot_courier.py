"""
A courier that stays connected
==============================

Load the problem, see what the robot believes about the channel, plan ten steps ahead from the
start, and look at the proof.
"""

# %%
# The problem: central Munich, a mast, a courier, and 300 measurements of a ray-traced channel.
from planopt import load, solve
from planopt.report import draw_belief, draw_solution

problem = load("munich_courier")
print(problem.description)
print(len(problem.workspace.obstacles), "buildings")

# %%
# One plan, ten steps of 4 s ahead. The belief it rests on comes with it: the fitted parameters, and
# the prediction anywhere with its deviation.
solution = solve(problem, horizon=10)
parameters = solution.belief.fit.parameters
print(f"path loss exponent {parameters.n_pl:.2f}")
print(f"shadowing {parameters.shadow_std_db:.1f} dB over {parameters.decorrelation_m:.0f} m")
belief_figure = draw_belief(problem, solution.belief)

# %%
# The plan, and what the verifier says of it. The verifier shares no code with the planner.
plan = solution.plan
certificate = plan.certificate
print(plan.verdict.value)
print(f"clearance of the swept path {certificate.min_clearance_m:.2f} m")
print(f"lowest P(connected) of the planned steps: {certificate.min_connectivity:.2f}")
print(f"cost {plan.objective:.1f} s; of the lattice path {plan.lattice_objective:.1f} s")
plan_figure = draw_solution(solution)
