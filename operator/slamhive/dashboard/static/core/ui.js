// SPDX-License-Identifier: Apache-2.0
/** The one door to Preact and htm. */
/** @template T @typedef {import('/vendor/preact.mjs').Context<T>} Context */
/** @typedef {import('/vendor/preact.mjs').Shown} Shown */

export {
  html,
  render,
  createContext,
  useState,
  useEffect,
  useLayoutEffect,
  useRef,
  useMemo,
  useCallback,
  useContext,
} from '/vendor/preact.mjs';
