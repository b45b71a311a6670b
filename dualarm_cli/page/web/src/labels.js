// Ids shortened to the room that there is.

/**
 * Returns how many first characters of all ids are the same, up to a separator, so that the rest still tells them apart.
 * @param {string[]} ids
 */
export function commonPrefix(ids) {
  const different = [...new Set(ids)];
  if (different.length < 2) return 0;
  let length = 0;
  while (
    different.every((id) => length < id.length && id[length] === different[0][length])
  ) {
    length++;
  }
  while (length > 0 && !/[-_. :/]/.test(different[0][length - 1])) length--;
  const zeros = () => different.every((id) => id[length] === "0" && /\d/.test(id[length + 1] ?? ""));
  while (zeros()) length++;
  return different.every((id) => id.length > length) ? length : 0;
}

/**
 * Returns the forms of an id, the longest first: in full, id, id without what all share.
 * @param {string} id
 * @param {string} full the id with what is done
 * @param {number} prefix how many characters all ids share (`commonPrefix`)
 * @returns {string[]}
 */
export function forms(id, full, prefix) {
  return [...new Set([full, id, id.slice(prefix)])];
}

/** Letters that a shortened id keeps at least. */
const FEWEST = 4;

/**
 * Returns the first form that fits; where none does, the last one with its middle left out, and no shorter than a few
 * letters even if these do not fit either.
 * @param {string[]} candidates the longest first
 * @param {number} room
 * @param {(text: string) => number} width
 */
export function fitting(candidates, room, width) {
  const whole = candidates.find((text) => width(text) <= room);
  if (whole !== undefined) return whole;
  const letters = [...candidates[candidates.length - 1]];
  let found = letters.join("");
  for (let kept = letters.length - 1; kept >= FEWEST; kept--) {
    const end = Math.ceil(kept / 2);
    found = `${letters.slice(0, kept - end).join("")}…${letters.slice(-end).join("")}`;
    if (width(found) <= room) return found;
  }
  return found;
}

/**
 * Returns the level of shortening that most labels of a row can bear, so that they look alike.
 * @param {{candidates: string[], room: number}[]} labels
 * @param {(text: string) => number} width
 * @returns {number} candidates before it are not used
 */
export function commonLevel(labels, width) {
  const levels = Math.max(0, ...labels.map((label) => label.candidates.length - 1));
  for (let level = 0; level < levels; level++) {
    const fit = labels.filter(({ candidates, room }) => {
      return width(candidates[Math.min(level, candidates.length - 1)]) <= room;
    });
    if (fit.length >= 0.75 * labels.length) return level;
  }
  return levels;
}
