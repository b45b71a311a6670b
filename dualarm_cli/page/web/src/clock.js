// The one cursor of time, and the stretch of time that the timeline shows.

/** Calls listeners when something has changed. */
export class Changing {
  constructor() {
    /** @type {(() => void)[]} */
    this.listeners = [];
  }

  /** @param {() => void} listener is called after each change */
  onChange(listener) {
    this.listeners.push(listener);
  }

  changed() {
    for (const listener of this.listeners) listener();
  }
}

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

/** The cursor of time: it stands at a time, or it plays. */
export class Clock extends Changing {
  /**
   * @param {number} duration s
   * @param {boolean} closes whether playback goes on from the start: the motion is a cycle
   */
  constructor(duration, closes) {
    super();
    this.duration = duration;
    this.closes = closes;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
  }

  /** @param {number} time s; beyond the plan is its start or its end */
  setTime(time) {
    this.time = Math.min(Math.max(Number.isFinite(time) ? time : 0, 0), this.duration);
    this.changed();
  }

  play() {
    if (this.time >= this.duration) this.time = 0;
    this.playing = true;
    this.changed();
  }

  pause() {
    this.playing = false;
    this.changed();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** @param {number} speed share of real time */
  setSpeed(speed) {
    this.speed = speed;
    this.changed();
  }

  /** @param {number} elapsed real time since the last call [s] */
  advance(elapsed) {
    if (!this.playing) return;
    const time = this.time + elapsed * this.speed;
    if (time < this.duration) {
      this.setTime(time);
    } else if (this.closes) {
      this.setTime(time % this.duration);
    } else {
      this.playing = false;
      this.setTime(this.duration);
    }
  }
}

/** The stretch of time that the timeline shows. */
export class TimeWindow extends Changing {
  /** @param {number} duration s */
  constructor(duration) {
    super();
    this.duration = duration;
    this.from = 0;
    this.to = duration;
  }

  /**
   * Shows a stretch, shifted into the plan and no shorter than a millisecond.
   * @param {number} from
   * @param {number} to
   */
  show(from, to) {
    const length = Math.min(Math.max(to - from, 1e-3), this.duration);
    this.from = Math.min(Math.max(from, 0), this.duration - length);
    this.to = this.from + length;
    this.changed();
  }

  showAll() {
    this.show(0, this.duration);
  }

  /**
   * Shows less or more, with one instant kept in place.
   * @param {number} time that instant
   * @param {number} factor below 1 shows less
   */
  zoom(time, factor) {
    const length = Math.min((this.to - this.from) * factor, this.duration);
    const share = (time - this.from) / (this.to - this.from);
    this.show(time - share * length, time + (1 - share) * length);
  }

  /** @param {number} time is brought into sight, if it is not */
  reveal(time) {
    if (time >= this.from && time <= this.to) return;
    const length = this.to - this.from;
    this.show(time - 0.1 * length, time + 0.9 * length);
  }
}

/**
 * Returns the next of some times after (or, with direction -1, before) a time; the time itself where there is none.
 * @param {number[]} times
 * @param {number} time
 * @param {1 | -1} direction
 */
export function neighbour(times, time, direction) {
  const beyond = times.filter((t) => (t - time) * direction > 1e-6);
  if (beyond.length === 0) return time;
  return direction > 0 ? Math.min(...beyond) : Math.max(...beyond);
}
