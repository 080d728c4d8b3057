// SPDX-License-Identifier: Apache-2.0
/** The one door to Preact and htm. */
export { html, render, createContext, useState, useEffect, useLayoutEffect, useRef, useMemo, useCallback, useContext } from '/vendor/preact.mjs';
