"""The numbers of the step, common to both of its statements, each with where it comes from."""

# ------------------------------------------------------------------------------ singular directions

REGULAR, MOST_REGULAR = 0.05, 50.0
"""σ₁: singular value, m/rad or 1, from which on a direction is met exactly; 50 ε if that is less,
and 2 ε at least. An arm of 1 m is 1.3 mm inside its reach there."""
BRAKING = 0.8
"""Share of the acceleration limits that is planned with where a motion ends; what it leaves is for
the curvature of the motion."""
SMOOTHED = 0.005
"""T, s: in a step of this length or a longer one a weak direction is damped by σ₁. In a shorter one
an error, and its noise, is divided by less time."""
BEND = 0.6
"""ℓ as a share of the largest singular value: measured on arms of six and seven joints, no singular
value below σ₁ changes faster with the joints."""
DEPENDENT = 1e-10
"""Directions above this share of the largest singular value of a level's rows, as they are stated,
are closed to the levels below. What is smaller is rounding: of a direction that the levels above
fix wholly there is no more left."""
NEARLY_UNSEEN = 1e-4
"""Singular values of J below this share of the largest count, by degrees, as unseen."""

# -------------------------------------------------------------------------------- scale and relaxed

WORTH = 50.0
"""γ: full speed is worth 50 times the joint motion that the task asks for by itself. A larger one
comes nearer to the largest scale, and joints at their limits reverse where it moves."""
LARGEST = 1e8
"""γ for which s is the largest and the rest optimal (a linear program with a small quadratic cost:
Mangasarian, Appl. Math. Optim. 5, 1979): of 65,879 random steps that had to be slowed down 5 were
up to 1e-4 too slow with 1e6, and none by 1e-7 with 1e8."""
OF_COSTS = 10.0
"""Multipliers up to so many times the gradient of the costs are not those of the largest scale:
these are larger by the order of ``LARGEST``."""
SCALE_BACKOFF = 1e-8
"""Share of the largest scale that is given up: on the very edge rounding would decide whether the
rows have a solution."""
WHOLE = 1.0 - 1e-8
"""Scale from which the first level counts as met at full speed: the tolerance of a verified row."""
BEYOND = 3.0
"""A task is cut to three times what the bounds allow its directions one by one. Of 300 arms whose
task was 25 to 800 times too fast ProxQP did not solve 5 with 1, 8 with 3, 27 with 10 and 91 without
a cut; with 1 an arm with a joint at its limit waited there."""
CURVED = 1e-2
"""δ: share of g that makes the program strictly convex in s."""
SOFT = 1e-4
"""Share of the largest σ² by which all directions of a relaxed task yield: 1e-4 of an error stays
in a step."""
DEAD = 0.03
"""η: share of the relaxed solution's progress below which the step passes over to it: a task that
stops would wait for a limit that it can go around."""
STILL = 1e-9
"""Progress below this share of the whole is none, so that rounding decides nothing at rest."""
LEAST_MOTION = 1e-12
"""Square of a task's motion beside which s is not priced lower, (rad/s)²: rest has no scale."""
ELASTIC_CURVED = 1e-8
"""η: share by which the price of an elastic row's slack grows until it has the size of the row's
speed, which makes the program strictly convex in it. The motion that balances a row's price is off
by this share of itself; held rows are not."""

# ------------------------------------------------------------------------------------- verification

EQUALITY_TOLERANCE = 1e-8
"""Largest equality residual, relative to 1 + max |b|; m/s and rad/s. Less is zero."""
BOUND_TOLERANCE = 1e-8
"""Largest excess over a bound or row, relative to 1 + max |x|."""
OPTIMALITY_TOLERANCE = 1e-6
"""Largest gradient that no multiplier explains, over max |H|, relative to 1 + max |x|; rad/s."""
GAIN_TOLERANCE = 1e-7
"""Largest cost that multipliers see beyond ``x``, relative to that of moving by 1 + max |x|."""
GAP_TOLERANCE = 5e-7
"""Largest duality gap, relative to the same."""
ROUNDING = 1e-11
"""What the sums of the optimality condition lose, as a share of their largest term."""
HELD = 1e-8
"""Constraints with a multiplier above this share of a level's first gradient become equality rows
for the levels below."""
DUST = 1e-13
"""Share of its terms below which a level's residual counts as zero."""

# ----------------------------------------------------------------------------- what can be computed

FASTEST = 1e9
"""Largest speed that a task or a secondary may ask for, m/s or rad/s."""
STEEPEST = 1e12
"""Largest linear cost, relative to the largest quadratic one."""
UNLIMITED = 1e12
"""A velocity bound beyond this counts as infinite, rad/s or m/s."""
NOTICEABLE = 1e-9
"""A smaller violation of a limit (rad, m, rad/s or m/s) is rounding: neither corrected nor
reported."""
