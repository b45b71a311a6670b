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
  return different.every((id) => id.length > length) ? length : 0;
}

/**
 * Returns the forms of an id, the longest first: in full, id, id without what all share, its end.
 * @param {string} id
 * @param {string} full the id with what is done
 * @param {number} prefix how many characters all ids share (`commonPrefix`)
 * @returns {string[]}
 */
export function forms(id, full, prefix) {
  const rest = [...id.slice(prefix)];
  const found = [full, id, id.slice(prefix)];
  if (rest.length > 8) found.push(`${rest.slice(0, 3).join("")}…${rest.slice(-3).join("")}`);
  if (rest.length > 5) found.push(`…${rest.slice(-3).join("")}`);
  return [...new Set(found)];
}

/**
 * Returns the first form that fits, or nothing where none does.
 * @param {string[]} candidates the longest first
 * @param {number} room
 * @param {(text: string) => number} width
 */
export function fitting(candidates, room, width) {
  return candidates.find((text) => width(text) <= room) ?? "";
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
