"""Notes of planning: on orders, modes, platform and effort."""

from __future__ import annotations

from dualarm_cli.notes import NoteTable

_BY_ESTIMATE = (
    "{total:.2f} s by the estimate of the search, which has few postures and platform angles per stop: a plan may be "
    "much faster"
)
_ON_GRID = "on the grid of the search (its postures, the platform standing at one of its angles)"
_NOT_PLANS = "this proves nothing about plans, which leave the grid"
_NO_FASTER = "no order takes less than {bound:.2f} s"
order_note = NoteTable(
    "order",
    of_file="order: that of the file, whose plan is faster than those of the orders found",
    one_arm="order: that of the file, where one arm does all tasks of either arm; no other order has a plan",
    fixed="order: --time-limit has no effect, as the task file fixes the order",
    ended_early="order: the search ended early, as {why}; a longer search may find a faster plan",
    after_part="order: {later} comes after {first}, as its part would obstruct it",
    after_link="order: {later} comes after {first}, as a part would obstruct it",
    sections="order: of {tried} planned orders, {whose} is the fastest: {rows:*, }",
    found=f"order: {{search}}; {_BY_ESTIMATE}",
    best=f"order: {_ON_GRID} this order is proven to be the best; {_NOT_PLANS}",
)
order_bound_note = NoteTable(
    "order bound",
    stages="order bound: on the grid of the search (its platform angles and postures), where this order takes "
    f"{{total:.2f}} s, {_NO_FASTER}; {_NOT_PLANS}: another order may be faster",
    clocks=f"order bound: {_ON_GRID}, where this order takes {{total:.2f}} s, {_NO_FASTER}; {_NOT_PLANS}",
)
mode_note = NoteTable(
    "mode",
    own_clocks="mode: free: {turns:the platform stands while tools work, and |}the arms run asynchronously; "
    + _BY_ESTIMATE,
    stands="mode: free: the platform stands {epochs:*, then }; meanwhile the arms run asynchronously; "
    + _BY_ESTIMATE,
    at="at {place:.0f} {unit} for {tasks:# task|# tasks}",
    synchronous="mode: free: synchronous stages would take {duration:.3f} s",
    no_own_clocks="mode: free: no plan was found in which the arms run asynchronously"
    "{turns: (the platform stands while tools work there)|}; both start each stage together",
    synchronous_faster="mode: free: both arms start each stage together, as that is faster than asynchronous arms"
    "{turns:, for which the platform has to stand|} ({duration:.3f} s)",
)
platform_note = NoteTable(
    "platform",
    held="platform: held where it starts; a platform of one joint is moved between stages: freeze the others",
    reach="platform: in stages {stages:*, } the solver's {rail:positions|angles} do not let every arm reach; "
    "the platform {rail:moves|turns} to the nearest {rail:position|angle} that does (platform solver: reach)",
)
dwell_note = NoteTable(
    "dwell",
    none="dwell: {stops:# pick or place takes|# picks and places take} no time ({shown:*, }); check `dwell` in "
    "the task file",
)
parts_note = NoteTable(
    "parts",
    yaw="parts: near others these keep the yaw of the file, although it is free: {stops:*, }",
)
grasp_note = NoteTable(
    "grasps",
    chosen="grasps: chosen by estimates on the grid of the search and by whole plans; the lower bound is for the "
    "chosen grasps, others may be faster",
)
effort_note = NoteTable(
    "effort",
    only="effort: the plan of {made} effort was taken, as {effort} found none",
    shorter="effort: the plan of {made} effort was taken, as it is {gain:.2g} s shorter than that of {effort}",
    interrupted="effort: less effort might give a shorter plan; its search was interrupted",
)
