//! Followers that join late, over links that lose, hold back and double messages, of services that
//! start again, vanish and come back, while maps change: a hundred schedules, each from its seed.

mod dice;
mod relay;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::{AliveToken, MapPublisher};
use dice::Dice;
use relay::{FAR, NEAR, Relay, Weather};

const SEEDS: u64 = 100;
/// Sessions that stand idle cost nothing: so many schedules go at once.
const AT_ONCE: usize = 12;
/// What followers are promised, told beside what they needed. The test's own bound is wider, for
/// slow machines.
const PROMISED: Duration = Duration::from_secs(2);
const BOUND: Duration = Duration::from_secs(20);

fn bus(prefix: &str, port: u16) -> Bus {
    Bus::open(BusConfig {
        prefix: prefix.to_owned(),
        // Small, so that deltas and tiles have chunks.
        max_message_bytes: 4096,
        idle_check_s: BusConfig::default().idle_check_s,
        ..config(&format!("['tcp/127.0.0.1:{port}']"), "[]")
    })
    .unwrap()
}

/// When the publisher says that its map is final.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    Open,
    FinalInTheCalm,
    FinalInTheStorm,
}

/// A service that publishes maps.
struct Service {
    bus: Bus,
    publisher: MapPublisher,
    alive: AliveToken,
}

impl Service {
    fn start(port: u16) -> Self {
        let bus = bus(NEAR, port);
        Self {
            publisher: bus.publish_map().unwrap(),
            alive: bus.declare_alive(crate::MAPPER_ROLE).unwrap(),
            bus,
        }
    }

    fn end(self) {
        drop((self.alive, self.publisher));
        close(self.bus);
    }
}

/// A map that differs from the one before by what the dice say.
fn changed(map: &Snapshot, dice: &mut Dice) -> Snapshot {
    let mut next = map.clone();
    next.sequence += 1;
    next.through_ping += 10;
    next.time = Timestamp::from_millis(next.sequence as i64 * 100);
    let gone = dice.below(20);
    next.gaussians.retain(|_| !dice.is_below(gone));
    let shaken = dice.below(60);
    for gaussian in &mut next.gaussians {
        if dice.is_below(shaken) {
            // Some leave their tile for another.
            gaussian.mean_m += Vec3::splat(2.0 * dice.share() as f32 - 1.0);
        }
    }
    let first = next.gaussians.last().map_or(0, |gaussian| gaussian.id + 1);
    let born = dice.below(60) as u32;
    next.gaussians.extend((first..first + born).map(gaussian));
    next
}

/// One schedule, under way.
struct Run {
    port: u16,
    relay: Relay,
    service: Service,
    map: Snapshot,
    dice: Dice,
}

impl Run {
    fn start(seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        let port = free_port();
        let weather = Weather {
            lost: dice.below(40),
            held: dice.below(40),
            doubled: dice.below(30),
            lost_replies: dice.below(10),
        };
        Self {
            port,
            relay: Relay::at(port, dice.next(), weather),
            service: Service::start(port),
            map: (*snapshot(dice.next() >> 1, 1, Vec::new())).clone(),
            dice,
        }
    }

    fn offer(&self) {
        self.service.publisher.offer(Arc::new(self.map.clone()));
    }

    /// One thing happens, mostly that the map changes.
    fn step(mut self) -> Self {
        self.map = changed(&self.map, &mut self.dice);
        match self.dice.below(40) {
            0 => {
                self.service.end();
                self.map.epoch = self.dice.next() >> 1;
                self.service = Service::start(self.port);
            }
            1 => {
                self.map = (*snapshot(self.map.epoch + 1, 1, Vec::new())).clone();
                self.map = changed(&self.map, &mut self.dice);
            }
            2 => self.relay.set_deaf(true),
            3..8 => self.relay.set_deaf(false),
            _ => {}
        }
        self.offer();
        std::thread::sleep(Duration::from_millis(self.dice.below(40)));
        self
    }

    /// How long after the last of everything the follower had the map.
    fn calm_down(&self, follower: &crate::MapSubscriber, ending: Ending) -> Duration {
        if ending == Ending::FinalInTheStorm {
            self.service.publisher.flush(LONG).unwrap();
            until("the last delta came to the relay", || {
                self.relay.newest_delta().elapsed() > 2 * relay::HELD
            });
        }
        self.relay.set_deaf(false);
        self.relay.set_weather(Weather::CALM);
        let calm = Instant::now();
        if ending == Ending::FinalInTheCalm {
            self.service.publisher.flush(LONG).unwrap();
        }
        let has_it = || {
            let map = follower.newest();
            map.is_some_and(|map| {
                let same_map = same(&map.gaussians, &self.map.gaussians);
                same_map && map.epoch == self.map.epoch && map.time == self.map.time
            })
        };
        while !has_it() || (ending != Ending::Open && !follower.is_final()) {
            let (waited, counters) = (calm.elapsed(), follower.counters());
            assert!(
                waited < BOUND,
                "another map after {waited:?}, {ending:?}, {counters:?}"
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        let last = self.relay.newest_delta().max(calm);
        last.elapsed()
    }
}

/// What the follower needed, and what it went through.
fn schedule(seed: u64) -> (Duration, crate::MapSubscriberCounters) {
    let mut run = Run::start(seed);
    let joins_at = run.dice.below(20);
    let steps = joins_at + 20 + run.dice.below(20);
    let receiver = bus(FAR, run.port);
    let mut follower = None;
    for step in 0..steps {
        if step == joins_at {
            follower = Some(receiver.subscribe_map().unwrap());
        }
        run = run.step();
    }
    let follower = follower.unwrap();
    let ending = match seed % 3 {
        0 => Ending::Open,
        1 => Ending::FinalInTheCalm,
        _ => Ending::FinalInTheStorm,
    };
    let took = run.calm_down(&follower, ending);
    (took, follower.counters())
}

#[test]
fn a_hundred_schedules_end_with_the_services_map() {
    let next = AtomicU64::new(0);
    let told = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= SEEDS {
                        return;
                    }
                    println!("seed {seed}");
                    let (took, counters) = schedule(seed);
                    told.lock().unwrap().push((took, seed, counters));
                }
            });
        }
    });
    let mut told = told.into_inner().unwrap();
    assert_eq!(told.len() as u64, SEEDS);
    told.sort_by_key(|(took, ..)| *took);
    let late = told.iter().filter(|(took, ..)| *took > PROMISED).count();
    let sum = |of: fn(&crate::MapSubscriberCounters) -> u64| -> u64 {
        told.iter().map(|(_, _, counters)| of(counters)).sum()
    };
    let (gaps, epochs) = (sum(|c| c.assembler.gaps), sum(|c| c.assembler.epochs));
    let (old, incomplete) = (
        sum(|c| c.assembler.deltas_old),
        sum(|c| c.deltas_incomplete),
    );
    println!(
        "the map was there after {:?} in the middle, {:?} at most (seed {}), {late} later than \
         {PROMISED:?}; {gaps} gaps, {epochs} epochs, {old} deltas that were old, {incomplete} cut",
        told[told.len() / 2].0,
        told[told.len() - 1].0,
        told[told.len() - 1].1,
    );
    // The schedules do what they say, on a slow machine fewer times.
    let enough = SEEDS / 5;
    assert!(gaps > enough && epochs > 0 && old > enough && incomplete > 0);
}
