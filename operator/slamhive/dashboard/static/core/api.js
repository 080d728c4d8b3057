// SPDX-License-Identifier: Apache-2.0
/** Reading the API. The browser keeps answers and asks with their ETag; a new revision asks again. */
import { SITE } from './address.js';
import { createContext, useContext, useEffect, useState } from './ui.js';

/** An answer that says what was wrong: `field` is the parameter that it was about. */
export class ApiError extends Error {
  /** @param {string} message @param {number} status @param {string|null} [field] */
  constructor(message, status, field = null) {
    super(message);
    this.status = status;
    this.field = field;
  }
}

/**
 * Return the JSON at an address of the API.
 * @param {string} url
 * @param {AbortSignal} [signal]
 * @returns {Promise<any>}
 */
export async function fetchJson(url, signal) {
  if (SITE) return (await import('./site.js')).answer(url);
  let answer;
  try {
    answer = await fetch(url, { signal, headers: { Accept: 'application/json' } });
  } catch (error) {
    if (error instanceof Error && error.name === 'AbortError') throw error;
    throw new ApiError('The dashboard does not answer. It is tried again by itself.', 0);
  }
  const body = await answer.json().catch(() => null);
  if (!answer.ok)
    throw new ApiError(
      body?.error ?? `The dashboard answered ${answer.status}.`,
      answer.status,
      body?.field ?? null,
    );
  return body;
}

/**
 * The state of what is known: revision, counts, problems, whether the server answers. @type
 * {import('./ui.js').Context<LiveState>}
 */
export const Live = createContext(
  /** @type {LiveState} */ ({ revision: null, connected: true, problems: [] }),
);

/** Time after which a server that was busy is asked again, as its Retry-After says, ms. */
const BUSY_MS = 5000;

/** What asks a busy server again: how often it did, and what does it later if an error says so. */
function useAgain() {
  const [tries, setTries] = useState(0);
  /** @param {ApiError|null|undefined} error */
  const again = (error) =>
    error?.status === 503 ? setTimeout(() => setTries((count) => count + 1), BUSY_MS) : undefined;
  return { tries, again };
}

const UNKNOWN = { url: null, data: null, current: null, error: null, loading: true };

/**
 * Fetch an address, again at each new revision; the last answer stays until the next one is there.
 * @template [T=any]
 * @param {string|null} url null fetches nothing
 * @returns {Loading<T>} current: the data, if they are already of this very address
 */
export function useData(url) {
  const { revision, connected } = useContext(Live);
  const [state, setState] = useState(/** @type {Loading<any> & {url: string|null}} */ (UNKNOWN));
  const { tries, again } = useAgain();
  useEffect(() => {
    if (url === null || (state.url === url && revision && state.data?.revision === revision))
      return undefined;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let later;
    const abort = new AbortController();
    setState((last) => ({ ...last, loading: true }));
    fetchJson(url, abort.signal).then(
      (data) => setState({ url, data, current: null, error: null, loading: false }),
      (error) => {
        if (error.name === 'AbortError') return;
        later = again(error);
        setState((last) => ({
          url,
          data: error.status === 0 ? last.data : null,
          current: null,
          error,
          loading: false,
        }));
      },
    );
    return () => {
      clearTimeout(later);
      abort.abort();
    };
  }, [url, revision, connected, tries]);
  return url === null
    ? { data: null, error: null, loading: false, current: null }
    : { ...state, current: state.url === url ? state.data : null };
}

/**
 * Fetch several addresses; one that fails gives its error in its place.
 * @param {Array<string|null>} urls null gives no data and no error
 * @returns {Array<{data: any, error: ApiError|null}>|null} null until all are there
 */
export function useAll(urls) {
  const { revision } = useContext(Live);
  const key = urls.map(String).join(' ');
  const [state, setState] = useState(null);
  const { tries, again } = useAgain();
  useEffect(() => {
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let later;
    const abort = new AbortController();
    Promise.all(
      urls.map(
        (url) =>
          url !== null &&
          fetchJson(url, abort.signal).then(
            (data) => ({ data, error: null }),
            (error) => ({ data: null, error }),
          ),
      ),
    ).then((answers) => {
      if (abort.signal.aborted) return;
      const found = answers.map((one) => one || { data: null, error: null });
      later = again(found.find(({ error }) => error?.status === 503)?.error);
      setState({ key, answers: found });
    });
    return () => {
      clearTimeout(later);
      abort.abort();
    };
  }, [key, revision, tries]);
  return state?.key === key ? state.answers : null;
}

/**
 * Return those of some addresses of the API that have an answer: of a server all, of a site what was computed
 * when it was made, and none until that is known.
 * @param {string[]} urls
 * @returns {string[]}
 */
export function useAnswered(urls) {
  const [found, setFound] = useState(/** @type {string[]} */ ([]));
  const key = urls.join(' ');
  useEffect(() => {
    if (!SITE || key === '') return undefined;
    let isLeft = false;
    import('./site.js')
      .then((site) => site.computed(key.split(' ')))
      .then(
        (one) => isLeft || setFound(one),
        () => {},
      );
    return () => {
      isLeft = true;
    };
  }, [key]);
  return SITE ? found : urls;
}

/**
 * Add `format=csv` to an address of the API: the table behind it.
 * @param {string} url
 */
export const csvOf = (url) => `${url}${url.includes('?') ? '&' : '?'}format=csv`;

const ASKING = 'This page asks for news every 5 s: too many pages are told of them already.';

/**
 * Tell of each new revision: server-sent events, or asking every 5 s where they don't come.
 * @param {(live: LiveState) => void} tell
 * @returns {() => void} ends it
 */
export function follow(tell) {
  if (SITE) {
    fetchJson('/api/v1').then(
      ({ revision, counts }) => tell({ connected: true, problems: [], revision, counts }),
      (error) => tell({ connected: false, problems: [error.message], revision: null }),
    );
    return () => {};
  }
  /** @type {ReturnType<typeof setInterval> | undefined} */
  let timer;
  /** @type {LiveState} */
  let last = { revision: null, connected: true, problems: [] };
  /** @param {Partial<LiveState>} changes */
  const say = (changes) => {
    last = { ...last, ...changes };
    tell(last);
  };
  /** @type {EventSource|null} */
  let source = null;
  const poll = () =>
    fetchJson('/api/v1').then(
      (index) =>
        say({
          connected: true,
          revision: index.revision,
          counts: index.counts,
          // A refusal is for good; what breaks off is asked for again by the browser.
          problems: [...(index.problems ?? []), ...(source?.readyState === 2 ? [ASKING] : [])],
        }),
      (error) => say({ connected: error.status !== 0 }),
    );
  const quiet = () => {
    clearInterval(timer);
    timer = undefined;
  };
  const close = () => {
    source?.close();
    source = null;
    quiet();
  };
  const open = () => {
    if (source) return;
    source = new EventSource('/api/v1/events');
    source.addEventListener('revision', (event) => {
      quiet();
      say({ connected: true, problems: [], ...JSON.parse(event.data) });
    });
    source.addEventListener('error', () => {
      poll();
      timer ??= setInterval(poll, 5000);
    });
  };
  // A browser opens six connections to a server at most: tabs that nobody looks at must not hold one each.
  const look = () => (document.hidden ? close() : open());
  document.addEventListener('visibilitychange', look);
  addEventListener('pagehide', close);
  addEventListener('pageshow', look);
  look();
  return () => {
    close();
    document.removeEventListener('visibilitychange', look);
    removeEventListener('pagehide', close);
    removeEventListener('pageshow', look);
  };
}
