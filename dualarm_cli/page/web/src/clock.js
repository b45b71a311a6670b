// Time cursor and visible time window.

/** Object that notifies listeners of its changes. */
export class Observable {
  constructor() {
    /** @type {(() => void)[]} */
    this.listeners = [];
  }

  /** @param {() => void} listener called after each change */
  onChange(listener) {
    this.listeners.push(listener);
  }

  notify() {
    for (const listener of this.listeners) listener();
  }
}

/** Playback speeds as factors of real time. */
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

/** Time cursor with playback. */
export class Clock extends Observable {
  /**
   * @param {number} duration s
   * @param {boolean} closes whether the motion is a cycle, so that playback continues from the start
   */
  constructor(duration, closes) {
    super();
    this.duration = duration;
    this.closes = closes;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    /** Whether playback stops at the end, also of a cycle. */
    this.once = false;
  }

  /** @param {number} time s; clamped to the plan */
  setTime(time) {
    this.time = Math.min(Math.max(Number.isFinite(time) ? time : 0, 0), this.duration);
    this.notify();
  }

  play() {
    if (this.time >= this.duration) this.time = 0;
    this.playing = true;
    this.once = false;
    this.notify();
  }

  /** Play to the end and stop there. */
  playOnce() {
    this.play();
    this.once = true;
  }

  pause() {
    this.playing = false;
    this.notify();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** @param {number} speed factor of real time */
  setSpeed(speed) {
    this.speed = speed;
    this.notify();
  }

  /** @param {number} elapsed real time since the last call [s] */
  advance(elapsed) {
    if (!this.playing) return;
    const time = this.time + elapsed * this.speed;
    if (time < this.duration) {
      this.setTime(time);
    } else if (this.closes && !this.once) {
      this.setTime(time % this.duration);
    } else {
      this.playing = false;
      this.setTime(this.duration);
    }
  }
}

/** Visible time window of the timeline. */
export class TimeWindow extends Observable {
  /** @param {number} duration s */
  constructor(duration) {
    super();
    this.duration = duration;
    this.from = 0;
    this.to = duration;
  }

  /**
   * Show a window, shifted into the plan and at least a millisecond long.
   * @param {number} from
   * @param {number} to
   */
  show(from, to) {
    const length = Math.min(Math.max(to - from, 1e-3), this.duration);
    this.from = Math.min(Math.max(from, 0), this.duration - length);
    this.to = this.from + length;
    this.notify();
  }

  showAll() {
    this.show(0, this.duration);
  }

  /**
   * Zoom about a fixed instant.
   * @param {number} time fixed instant [s]
   * @param {number} factor of the length; below 1 zooms in
   */
  zoom(time, factor) {
    const length = Math.min((this.to - this.from) * factor, this.duration);
    const fraction = (time - this.from) / (this.to - this.from);
    this.show(time - fraction * length, time + (1 - fraction) * length);
  }

  /** @param {number} time s; the window is moved if it does not contain it */
  reveal(time) {
    if (time >= this.from && time <= this.to) return;
    const length = this.to - this.from;
    this.show(time - 0.1 * length, time + 0.9 * length);
  }
}

/**
 * Return the next time after a time (direction 1) or before it (-1), or the time itself if there is none.
 * @param {number[]} times
 * @param {number} time
 * @param {1 | -1} direction
 */
export function neighbour(times, time, direction) {
  const candidates = times.filter((t) => (t - time) * direction > 1e-6);
  if (candidates.length === 0) return time;
  return direction > 0 ? Math.min(...candidates) : Math.max(...candidates);
}
