"""The referee: laps, off-track, contacts and who is to blame, penalties, running order.

`judge` looks at a world before and after physics and says what happened (Verdict) with its new
book (Standing); it moves nobody. `penalise` applies the race's penalties; in training a mistake
ends the episode instead.
Rules: facts section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from league.geometry import rotate
from league.sim import grid
from league.sim.config import CarConfig, SimConfig
from league.sim.world import Contacts, Standing, World
from league.track.course import Projection, TrackSet

NOBODY = -1
_OPEN_TRACK_MARGIN = 0.3
_PASS = 1.0


@dataclass(frozen=True)
class Verdict:
    """What the referee found in one step, (num_worlds, num_cars) unless said otherwise."""

    advance: Tensor
    """Signed movement along the track in this step [m]."""
    off_track: Tensor
    """All four wheels have left the road, bool."""
    crashed: Tensor
    """A contact this car is to blame for, bool."""
    crashed_car: Tensor
    """The car it ran into, or NOBODY, int64."""
    crashed_obstacle: Tensor
    """The obstacle it ran into, or NOBODY, int64."""
    was_hit: Tensor
    """A contact another car is to blame for, bool."""
    wall: Tensor
    """The car touches the wall, bool."""
    immobilised: Tensor
    """Stood still too long, bool."""
    reversed: Tensor
    """Drove backwards too long, bool."""
    lap: Tensor
    """Completed a lap in this step, bool."""
    finished: Tensor
    """Completed its last lap in this step, bool."""
    overtook: Tensor
    """Cars passed on the road, bool, (num_worlds, num_cars, num_cars): [w, i, j], i passed j."""
    lead_changed: Tensor
    """Another car leads, bool, (num_worlds,)."""
    released: Tensor
    """A penalty ended in this step, bool."""

    @property
    def mistake(self) -> Tensor:
        """Anything that ends an episode in training and costs a penalty in a race."""
        return self.off_track | self.crashed | self.immobilised | self.reversed


def judge(
    tracks: TrackSet, sim: SimConfig, before: World, after: World, contacts: Contacts
) -> tuple[Verdict, Standing]:
    """Return what happened between two worlds, and the referee's new book.

    Args:
        tracks: the courses.
        sim: settings.
        before: the worlds before the step.
        after: the worlds after physics, `step` counted up, still with the old book.
        contacts: what touched what during the step.
    """
    old, rules = before.standing, sim.rules
    frozen = old.penalty_s > 0
    place = tracks.project(after.track, after.motion.x, after.motion.y, old.s)
    advance = tracks.signed_gap(after.track, place.s, old.s)
    distance = _unwrapped(tracks, after, place, old.distance + advance)
    penalty_s, released = old.penalty_s, frozen
    if bool(frozen.any()):
        # Who stands still keeps its place: off the inside of a hairpin the search would creep on.
        place = replace(
            place,
            s=torch.where(frozen, old.s, place.s),
            lateral=torch.where(frozen, old.lateral, place.lateral),
        )
        advance = torch.where(frozen, 0.0, advance)
        distance = torch.where(frozen, old.distance, distance)
        # Counted in whole steps, so that no rounding adds or drops one.
        steps_left = torch.clamp(torch.round(old.penalty_s * sim.step_hz) - 1.0, min=0.0)
        penalty_s, released = steps_left / sim.step_hz, frozen & (steps_left == 0)
    racing = ~frozen & torch.isinf(old.finish_s)

    off_track = racing & ~_any_wheel_on_road(tracks, sim.car, after, place)
    fault = _blame(tracks, sim, before, after, place, contacts)
    crashed = racing & fault.to_blame
    still_steps, immobilised = _stillness(sim, before, after, racing)
    backward_steps = torch.where(racing & (advance < 0), old.backward_steps + 1, 0)
    backwards = backward_steps >= rules.patience_steps
    laps = _lap_times(tracks, sim, before, old, distance, racing)
    ahead, overtook, leader = _order(tracks, sim, after, laps.standing, place.s, distance, racing)

    verdict = Verdict(
        advance=advance,
        off_track=off_track,
        crashed=crashed,
        crashed_car=fault.car,
        crashed_obstacle=fault.obstacle,
        was_hit=fault.was_hit,
        wall=contacts.walls,
        immobilised=immobilised,
        reversed=backwards,
        lap=laps.lap,
        finished=laps.finished,
        overtook=overtook,
        lead_changed=leader != old.leader,
        released=released,
    )
    standing = replace(
        laps.standing,
        s=place.s,
        lateral=place.lateral,
        distance=distance,
        penalty_s=penalty_s,
        still_steps=still_steps,
        backward_steps=torch.where(backwards, 0, backward_steps),
        touching_cars=contacts.cars,
        touching_obstacles=contacts.obstacles,
        off_tracks=old.off_tracks + off_track,
        crashes=old.crashes + crashed,
        contacts_taken=old.contacts_taken + fault.was_hit,
        immobilised=old.immobilised + immobilised,
        reversed=old.reversed + backwards,
        overtakes=old.overtakes + _count(overtook),
        lead_changes=old.lead_changes + (leader != old.leader),
        ahead=ahead,
        leader=leader,
    )
    return verdict, standing


def penalise(tracks: TrackSet, sim: SimConfig, world: World, verdict: Verdict) -> World:
    """Apply the race's penalties: who made a mistake is frozen, then goes on (facts 5.2).

    After a crash the car is moved first, 1 m behind what it hit and to the other lane, then frozen.
    Off the track, backwards or immobilised: frozen where it stands, then put on the nearer lane.
    Frozen cars are ghosts, and stay so until nothing is near; so are cars that have finished. On an
    occupied spot a car thus drives on as a ghost until it is clear of whoever is there.
    """
    rules = sim.rules
    changing = verdict.mistake | verdict.released | verdict.finished | world.standing.ghost
    if not bool(changing.any()):
        return world  # nobody is, was or becomes a ghost
    if bool(verdict.released.any()):
        world = grid.release(tracks, world, verdict.released)
    if bool(verdict.crashed.any()):
        world = grid.put_behind(
            tracks, sim, world, verdict.crashed, verdict.crashed_car, verdict.crashed_obstacle
        )
    penalty = world.standing.penalty_s
    for who, seconds in (
        (verdict.immobilised, rules.immobilised_penalty_s),
        (verdict.reversed, rules.reversed_penalty_s),
        (verdict.off_track, rules.off_track_penalty_s),
        (verdict.crashed, rules.crash_penalty_s),
    ):
        # At least one step: the car is put back by the end of its penalty.
        penalty = torch.where(who, max(seconds, sim.step_dt), penalty)
    book = world.standing
    over = ~torch.isinf(book.finish_s)
    ghost = (penalty > 0) | over
    wanting = book.ghost & ~ghost
    if bool(wanting.any()):
        solid = ~book.ghost & ~ghost
        ghost = ghost | (wanting & ~grid.clear_of_others(sim.car, world, solid, wanting))
    book = replace(
        book,
        penalty_s=penalty,
        put_back=torch.where(verdict.mistake, ~verdict.crashed, book.put_back),
        ghost=ghost,
    )
    return replace(world, standing=book)


def stop_bots(sim: SimConfig, world: World, verdict: Verdict) -> World:
    """Have all bot cars stand for a while after one ran into a car ahead of it (facts 5.1)."""
    if sim.num_obstacles == 0 or sim.obstacles.kind == "box":
        return world
    touched = world.standing.touching_obstacles & ~verdict.crashed.unsqueeze(2)
    hit = touched.flatten(1).any(dim=1, keepdim=True)
    things = world.obstacles
    stopped_s = torch.where(hit, sim.rules.bot_stop_s, things.stopped_s)
    return replace(world, obstacles=replace(things, stopped_s=stopped_s))


def places(standing: Standing) -> Tensor:
    """Return each car's place from 0: by finish, then by who is ahead; (num_worlds, num_cars).

    Of three cars side by side each may still be ahead of the next, in a ring; distance unties them.
    """
    beaten, distance = _count(standing.ahead), standing.distance
    slot = torch.arange(beaten.shape[1], device=beaten.device)
    more = beaten.unsqueeze(1) > beaten.unsqueeze(2)  # [w, i, j]: j beats more cars than i
    equal = beaten.unsqueeze(1) == beaten.unsqueeze(2)
    further = distance.unsqueeze(1) > distance.unsqueeze(2)
    level = (distance.unsqueeze(1) == distance.unsqueeze(2)) & (slot < slot.unsqueeze(1))
    return _count(more | (equal & (further | level)))


def lap_length(tracks: TrackSet, track: Tensor) -> Tensor:
    """Return what counts as a lap [m], (num_worlds, 1): the loop, or an open track but its end."""
    length = tracks.length.index_select(0, track)
    if not tracks.all_closed:
        length = torch.where(tracks.closed[track], length, length - _OPEN_TRACK_MARGIN)
    return length.unsqueeze(1)


def wheel_positions(car: CarConfig, world: World) -> tuple[Tensor, Tensor]:
    """Return the wheel centres in the world frame [m], (num_worlds, num_cars, 4)."""
    cos = torch.cos(world.motion.yaw).unsqueeze(-1)
    sin = torch.sin(world.motion.yaw).unsqueeze(-1)
    half_base, half_track = car.wheelbase / 2, car.wheel_track / 2
    along = cos.new_tensor([half_base, half_base, -half_base, -half_base])
    across = cos.new_tensor([half_track, -half_track, half_track, -half_track])
    dx, dy = rotate(along, across, cos, sin)
    return world.motion.x.unsqueeze(-1) + dx, world.motion.y.unsqueeze(-1) + dy


def _any_wheel_on_road(tracks: TrackSet, car: CarConfig, world: World, place: Projection) -> Tensor:
    # A wheel is at most this far from the base: nearer to the middle than that, one is surely on.
    reach = 0.5 * (car.wheelbase**2 + car.wheel_track**2) ** 0.5
    surely = (place.lateral < place.left) & (place.lateral > -place.right)
    if bool(surely.all()):
        return surely
    doubtful = ~surely & (place.lateral.abs() < torch.maximum(place.left, place.right) + reach)
    # Only these few are looked at: of each, four wheels on the track of its world.
    which = doubtful.nonzero(as_tuple=True)
    x, y = wheel_positions(car, world)
    near_s = place.s[which].unsqueeze(1).expand(-1, 4).contiguous()
    wheel = tracks.project(world.track[which[0]], x[which], y[which], near_s)
    on = (wheel.lateral <= wheel.left) & (wheel.lateral >= -wheel.right)
    found = surely.clone()
    found[which] = on[:, 0] | on[:, 1] | on[:, 2] | on[:, 3]
    return found


def _unwrapped(tracks: TrackSet, world: World, place: Projection, rough: Tensor) -> Tensor:
    """Return the distance driven as whole laps plus the place on this one, so no error adds up."""
    length = tracks.length.index_select(0, world.track).unsqueeze(1)
    on_lap = place.s - world.standing.zero_s
    turns = torch.round((rough - on_lap) / length)
    if not tracks.all_closed:
        turns = torch.where(tracks.closed[world.track].unsqueeze(1), turns, 0.0)
    return turns * length + on_lap


@dataclass(frozen=True)
class _Fault:
    to_blame: Tensor
    was_hit: Tensor
    car: Tensor
    obstacle: Tensor


def _blame(
    tracks: TrackSet,
    sim: SimConfig,
    before: World,
    after: World,
    place: Projection,
    contacts: Contacts,
) -> _Fault:
    """Judge contacts: of two cars the rear one along the track is to blame.

    Contact with a box is the car's own fault; with a bot car it is if the bot was ahead. Of several
    that were hit at once, the rearmost is named.
    """
    was_hit = torch.zeros_like(contacts.walls)
    nobody = torch.full_like(place.s, NOBODY, dtype=torch.int64)
    car, thing = nobody, nobody
    if bool(contacts.cars.any()):
        new_cars = contacts.cars & ~before.standing.touching_cars
        nearest = torch.full_like(place.s, torch.inf)
        for other in range(after.num_cars):
            gap = tracks.signed_gap(after.track, place.s[:, other : other + 1], place.s)
            fault = contacts.cars[:, :, other] & (gap > 0) & (gap < nearest)
            car, nearest = torch.where(fault, other, car), torch.where(fault, gap, nearest)
            was_hit = was_hit | (new_cars[:, :, other] & (gap < 0))
    if bool(contacts.obstacles.any()):
        always = sim.obstacles.kind == "box"
        nearest = torch.full_like(place.s, torch.inf)
        for index in range(contacts.obstacles.shape[2]):
            gap = tracks.signed_gap(after.track, after.obstacles.s[:, index : index + 1], place.s)
            fault = contacts.obstacles[:, :, index] & (gap < nearest)
            fault = fault if always else fault & (gap > 0)
            thing, nearest = torch.where(fault, index, thing), torch.where(fault, gap, nearest)
    to_blame = (car != NOBODY) | (thing != NOBODY)
    return _Fault(to_blame=to_blame, was_hit=was_hit, car=car, obstacle=thing)


def _stillness(
    sim: SimConfig, before: World, after: World, racing: Tensor
) -> tuple[Tensor, Tensor]:
    dx, dy = after.motion.x - before.motion.x, after.motion.y - before.motion.y
    still = dx * dx + dy * dy <= sim.rules.still_distance**2
    steps = torch.where(racing & still, before.standing.still_steps + 1, 0)
    fired = steps >= sim.rules.patience_steps
    return torch.where(fired, 0, steps), fired


@dataclass(frozen=True)
class _Laps:
    standing: Standing
    lap: Tensor
    finished: Tensor


def _lap_times(
    tracks: TrackSet, sim: SimConfig, before: World, old: Standing, distance: Tensor, racing: Tensor
) -> _Laps:
    """Count laps, forward only; the time of crossing is interpolated within the step.

    An open track is driven once, however many laps were asked.
    """
    length = lap_length(tracks, before.track)
    target = (old.laps + 1).to(distance.dtype) * length
    lap = racing & (distance >= target) & (old.best_distance < target)
    best_distance = torch.maximum(old.best_distance, distance)
    if not bool(lap.any()):
        return _Laps(standing=replace(old, best_distance=best_distance), lap=lap, finished=lap)
    step_s = before.step.to(distance.dtype).unsqueeze(1) * sim.step_dt
    travelled = torch.clamp(distance - old.distance, min=1e-9)
    part = torch.clamp((target - old.distance) / travelled, 0.0, 1.0)
    crossing = step_s + part * sim.step_dt
    lap_s = crossing - old.lap_start_s
    laps = old.laps + lap
    enough = torch.where(tracks.closed[before.track], sim.rules.laps, 1).unsqueeze(1)
    finished = lap & (laps >= enough)
    standing = replace(
        old,
        best_distance=best_distance,
        laps=laps,
        lap_start_s=torch.where(lap, crossing, old.lap_start_s),
        last_lap_s=torch.where(lap, lap_s, old.last_lap_s),
        best_lap_s=torch.where(lap, torch.minimum(old.best_lap_s, lap_s), old.best_lap_s),
        finish_s=torch.where(finished, crossing, old.finish_s),
    )
    return _Laps(standing=standing, lap=lap, finished=finished)


def _order(
    tracks: TrackSet,
    sim: SimConfig,
    after: World,
    book: Standing,
    s: Tensor,
    distance: Tensor,
    racing: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return who is ahead of whom, who passed whom on the road, and the leader.

    `book` is the old one with the laps and finishes of this step; `racing` says who was neither
    frozen nor home before it.
    """
    if distance.shape[1] == 1:
        return book.ahead, torch.zeros_like(book.ahead), book.leader
    lead = distance.unsqueeze(2) - distance.unsqueeze(1)  # (num_worlds, num_cars, num_cars)
    one_race = book.zero_s.unsqueeze(2) == book.zero_s.unsqueeze(1)
    if not bool(one_race.all()):
        # Episodes that began at different places are compared by who is ahead on the road.
        on_road = tracks.signed_gap(after.track, s.unsqueeze(2), s.unsqueeze(1))
        lead = torch.where(one_race, lead, on_road)
    margin = sim.rules.overtake_margin
    ahead = (lead > margin) | (book.ahead & (lead >= -margin))
    under_way = torch.isinf(book.finish_s)
    if not bool(under_way.all()):
        # Whoever is home first is ahead for good, whatever it does on its cooling lap.
        finish, rival = book.finish_s.unsqueeze(2), book.finish_s.unsqueeze(1)
        home_first = (finish < rival) | ((finish == rival) & book.ahead)
        both_out = under_way.unsqueeze(2) & under_way.unsqueeze(1)
        ahead = torch.where(both_out, ahead, home_first)
    both = racing.unsqueeze(2) & racing.unsqueeze(1)
    # Half a lap apart, ahead turns to behind without a pass.
    overtook = ahead & ~book.ahead & both & (lead < _PASS)
    # Of cars side by side nobody may be ahead of all: then the leader stays.
    first = _count(ahead) == distance.shape[1] - 1
    leader = torch.where(first.any(dim=1), first.to(torch.int64).argmax(dim=1), book.leader)
    return ahead, overtook, leader


def _count(pairs: Tensor) -> Tensor:
    """Count True along the last axis; integers, so the order of adding does not matter."""
    return pairs.to(torch.int64).sum(dim=-1)
