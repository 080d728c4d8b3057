// SPDX-License-Identifier: Apache-2.0
/** Wide tables: their first columns stay in sight, and a line says how many lie to the right. */

/** Columns that can stay; app.css has as many. */
const MOST = 4;
/** Share of the width that columns which stay may take. */
const ROOM = 0.6;

/**
 * Return the class of a column's cells: the first ones stay where a table is scrolled sideways.
 * @param {number} at place of the column
 * @param {number} fixed how many stay, where there is room
 */
export const stays = (at, fixed) => (at < Math.min(fixed, MOST) ? `stays stays${at}` : '');

/**
 * Keep the first columns of a table in their places, as many as leave room for others, and tell of those that
 * are out of sight; used as `ref` of the box that scrolls.
 * @param {HTMLElement|null} box
 */
export function watch(box) {
  if (!box) return;
  const look = () => {
    const heads = [...box.querySelectorAll('thead th')];
    const wide = box.scrollWidth > box.clientWidth + 1;
    let left = 0;
    let kept = 0;
    for (const head of wide ? heads.filter((one) => one.classList.contains('stays')) : []) {
      const { width } = head.getBoundingClientRect();
      if (left + width > ROOM * box.clientWidth) break;
      box.style.setProperty(`--left${kept}`, `${left}px`);
      left += width;
      kept += 1;
    }
    box.dataset.kept = String(kept);
    const edge = box.getBoundingClientRect().left + box.clientWidth;
    const beyond = heads.filter((one) => one.getBoundingClientRect().right > edge + 2).length;
    const frame = /** @type {HTMLElement} */ (box.parentElement);
    frame.classList.toggle('goes-on', beyond > 0);
    const line = /** @type {HTMLElement} */ (frame.nextElementSibling);
    line.textContent = beyond ? `${beyond} more ${beyond > 1 ? 'columns' : 'column'} to the right →` : '';
  };
  box.addEventListener('scroll', look, { passive: true });
  const watcher = new ResizeObserver(look);
  watcher.observe(box);
  if (box.firstElementChild) watcher.observe(box.firstElementChild);
}
