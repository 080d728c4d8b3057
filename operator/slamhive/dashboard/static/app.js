// SPDX-License-Identifier: Apache-2.0
/** The frame around all pages: which page an address means, navigation, theme, what the server says. */
import { Address, readAddress, SITE } from './core/address.js';
import { follow, Live } from './core/api.js';
import { Link, NAME, Notes } from './core/parts.js';
import { html, render, useEffect, useState } from './core/ui.js';

/**
 * Pages are loaded when they are first shown. @type {Record<string, () => Promise<{default: () => Shown}>>}
 */
const PAGES = {
  '': () => import('./pages/overview.js'),
  sweeps: () => import('./pages/sweeps.js'),
  'sweeps/': () => import('./pages/sweep.js'),
  explore: () => import('./pages/explore.js'),
  leaderboard: () => import('./pages/leaderboard.js'),
  studies: () => import('./pages/studies.js'),
  table: () => import('./pages/table.js'),
  runs: () => import('./pages/runs.js'),
  'runs/': () => import('./pages/run.js'),
  compare: () => import('./pages/compare.js'),
  timeline: () => import('./pages/timeline.js'),
  paths: () => import('./pages/paths.js'),
  algorithms: () => import('./pages/catalog.js'),
  datasets: () => import('./pages/catalog.js'),
};
const ICON = new URL('icon.svg', import.meta.url).href;
const MENU = [
  ['/', 'Overview'],
  ['/sweeps', 'Sweeps'],
  ['/runs', 'Runs'],
  ['/explore', 'Explore'],
  ['/leaderboard', 'Leaderboard'],
  ['/studies', 'Studies'],
  ['/table', 'Table'],
  ['/compare', 'Compare'],
  ['/algorithms', 'Algorithms'],
  ['/datasets', 'Datasets'],
];

const remembered = () => {
  try {
    return localStorage.getItem('theme');
  } catch {
    return null;
  }
};

/** @param {'light'|'dark'} theme */
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  try {
    localStorage.setItem('theme', theme);
  } catch {
    /* a browser that keeps nothing: the theme lasts until the page is left */
  }
  dispatchEvent(new Event('themechange'));
}

function Theme() {
  const [dark, setDark] = useState(
    () =>
      (document.documentElement.dataset.theme ??
        (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light')) === 'dark',
  );
  return html`
    <button
      type="button"
      class="plain"
      aria-pressed=${String(dark)}
      onClick=${() => {
        setTheme(dark ? 'light' : 'dark');
        setDark(!dark);
      }}
    >
      ${dark ? 'Light' : 'Dark'}
    </button>
  `;
}

/** @param {{name: string}} props */
function Page({ name }) {
  const [page, setPage] = useState(null);
  useEffect(() => {
    let ended = false;
    const load = Object.hasOwn(PAGES, name) ? PAGES[name] : null;
    if (!load) setPage({ Shown: Nowhere });
    else
      load().then(
        (module) => ended || setPage({ Shown: module.default }),
        () => ended || setPage({ Shown: Broken }),
      );
    return () => {
      ended = true;
    };
  }, [name]);
  return page && html`<${page.Shown} />`;
}

const Nowhere = () => html`
  <h1>There is no such page</h1>
  <p>
    <${Link} href="/">To the overview</${Link}>
  </p>
`;
const Broken = () => html`
  <h1>This page could not be loaded</h1>
  <p>The dashboard may have stopped. Load the page again when it runs.</p>
`;

function App() {
  const [here, setHere] = useState(readAddress());
  const [live, setLive] = useState(
    /** @type {LiveState} */ ({ revision: null, connected: true, problems: [] }),
  );
  useEffect(() => {
    const read = () => setHere(readAddress());
    addEventListener('popstate', read);
    addEventListener('addresschange', read);
    const end = follow(setLive);
    return () => {
      removeEventListener('popstate', read);
      removeEventListener('addresschange', read);
      end();
    };
  }, []);
  // On a phone the menu is wider than the window.
  useEffect(
    () =>
      document
        .querySelector('header nav a[aria-current]')
        ?.scrollIntoView({ block: 'nearest', inline: 'center' }),
    [here.path[0]],
  );
  const embedded = here.query.get('embed') === '1';
  const [name = '', one] = here.path;
  const page = one !== undefined && Object.hasOwn(PAGES, `${name}/`) ? `${name}/` : name;
  return html`
    <${Address.Provider} value=${here}>
      <${Live.Provider} value=${live}>
        ${
          !embedded &&
          html`
            <a
              class="skip"
              href="#main"
              onClick=${
                SITE &&
                ((/** @type {Event} */ event) => {
                  event.preventDefault();
                  document.getElementById('main')?.focus();
                })
              }
            >
              To the content
            </a>
            <header>
              <${Link} class="brand" href="/">
                <img src=${ICON} alt="" width="26" height="26" />
                ${NAME}
              </${Link}>
              <nav aria-label="Pages">
                ${MENU.map(
                  ([href, text]) => html`
                    <${Link} href=${href} aria-current=${href.slice(1) === name ? 'page' : null}>
                      ${text}
                    </${Link}>
                  `,
                )}
              </nav>
              <${Theme} />
            </header>
          `
        }
        ${
          !live.connected &&
          html`
            <p class="banner" role="alert">
              ${
                SITE
                  ? 'A file of this site could not be read.'
                  : 'The dashboard does not answer; its last state is shown. It is asked again by itself.'
              }
            </p>
          `
        }
        <main id="main" tabindex="-1">
          <${Notes} notes=${live.problems} />
          <${Page} key=${page} name=${page} />
        </main>
      </${Live.Provider}>
    </${Address.Provider}>
  `;
}

const theme = remembered();
if (theme === 'light' || theme === 'dark') document.documentElement.dataset.theme = theme;
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () =>
  dispatchEvent(new Event('themechange')),
);
render(html`<${App} />`, /** @type {HTMLElement} */ (document.getElementById('app')));
