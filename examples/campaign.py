"""Run a campaign: simulate a motion with random masses, planned once and re-planned.

Run: python examples/campaign.py. The results are written to the folder `campaign`; another run resumes there.
"""

from pathlib import Path

from ffsms_pin.campaigns import Campaign, campaign, read_table, report

SCENARIO = """
[robot]
model = "planar_3r"

[start]
joints_deg = [23.0, 40.0, -29.0]

[target]
position = [0.75, 0.5, 0.0]  # [m]

[plan]
duration = 4.0  # [s]
dt = 0.05

[control]
law = "computed-torque"
dt = 0.01

[campaign.draw]  # factors on masses and inertias of the model, unknown to the planner
plant.arm_mass = { uniform = [0.7, 1.3] }
plant.base_mass = { uniform = [0.9, 1.1] }
"""

folder = Path("campaign")
folder.mkdir(exist_ok=True)
(folder / "scenario.toml").write_text(SCENARIO)
campaign(Campaign.read(folder / "scenario.toml", runs=4, compare=True), folder, jobs=1)

numbers = report(read_table(folder))
for method, of_method in numbers.items():
    low, high = of_method["success_rate_95_percent"]
    error = 1e3 * of_method["percentiles"]["final_error_m"][50]
    share = f"{100 * of_method['success_rate']:.0f} % arrived ({100 * low:.0f} to {100 * high:.0f} %)"
    print(f"{method}: {share}, final error {error:.2g} mm (median)")

errors = [of_method["percentiles"]["final_error_m"][50] for of_method in numbers.values()]
assert errors[1] < 0.5 * errors[0]  # re-planning ends nearer to the target
