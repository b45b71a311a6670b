// Task ids shortened to the available width, and names of joints with their numbers.

/**
 * Compute the length of the common prefix of all ids up to a separator; what remains stays unique.
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
  while (length > 0 && !/[-_. :/[]/.test(different[0][length - 1])) length--;
  const zeros = () => different.every((id) => id[length] === "0" && /\d/.test(id[length + 1] ?? ""));
  while (zeros()) length++;
  return different.every((id) => id.length > length) ? length : 0;
}

/**
 * Return the forms of an id, the longest first: with action, id, id without the common prefix.
 * @param {string} id
 * @param {string} full the id with its action
 * @param {number} prefix length of the common prefix (`commonPrefix`)
 * @returns {string[]}
 */
export function forms(id, full, prefix) {
  const place = id[prefix - 1] === "[" && id.endsWith("]"); // left[2,3]: 2,3
  return [...new Set([full, id, id.slice(prefix, place ? -1 : undefined)])];
}

/** Minimum number of letters of a shortened id. */
const MIN_LETTERS = 4;

/**
 * Return the first form that fits, or else the last one with its middle left out.
 *
 * A minimum number of letters remains even if they do not fit.
 * @param {string[]} candidates the longest first
 * @param {number} space px
 * @param {(text: string) => number} width
 */
export function fitting(candidates, space, width) {
  const complete = candidates.find((text) => width(text) <= space);
  if (complete !== undefined) return complete;
  const letters = [...candidates[candidates.length - 1]];
  let shortened = letters.join("");
  for (let count = letters.length - 1; count >= MIN_LETTERS; count--) {
    const end = Math.ceil(count / 2);
    shortened = `${letters.slice(0, count - end).join("")}…${letters.slice(-end).join("")}`;
    if (width(shortened) <= space) return shortened;
  }
  return shortened;
}

/**
 * Select the level of shortening at which three quarters of the labels fit, so that all look the same.
 * @param {{candidates: string[], space: number}[]} labels
 * @param {(text: string) => number} width
 * @returns {number} index of the first candidate that is used
 */
export function commonLevel(labels, width) {
  const levels = Math.max(0, ...labels.map((label) => label.candidates.length - 1));
  for (let level = 0; level < levels; level++) {
    const fit = labels.filter(({ candidates, space }) => {
      return width(candidates[Math.min(level, candidates.length - 1)]) <= space;
    });
    if (fit.length >= 0.75 * labels.length) return level;
  }
  return levels;
}

/**
 * Name a joint with its number in its arm, unless the maker's name ends in that number.
 * @param {{name: string, group: string}[]} joints
 * @param {string} name
 */
export function jointLabel(joints, name) {
  const { group } = joints.find((joint) => joint.name === name) ?? {};
  const number = joints.filter((joint) => joint.group === group).findIndex((joint) => joint.name === name) + 1;
  if (number === 0 || group === "platform" || new RegExp(`(^|\\D)${number}$`).test(name)) return name;
  return `${name} (${number})`;
}
