// SPDX-License-Identifier: Apache-2.0
/**
 * What the pages use of Preact and htm. Elements are opaque: templates are text, which nobody checks. What
 * begins as null is of any type later.
 */

export type Element = object;
export type Shown = Element | string | number | boolean | null | undefined | Shown[];
export type Context<T> = { Provider: (props: { value: T; children?: Shown }) => Shown };
/** Functions of events are told apart so that their parameters need no types. */
type Value = ((...values: any[]) => unknown) | object | string | number | boolean | null | undefined;
type Update<T> = T | ((last: T) => T);
type Effect = () => unknown;

export function html(strings: TemplateStringsArray, ...values: Value[]): Element;
export function render(element: Element, parent: HTMLElement): void;
export function createContext(initial: null): Context<any>;
export function createContext<T>(initial: T): Context<T>;
export function useContext<T>(context: Context<T>): T;
export function useState(initial: null): [any, (next: any) => void];
export function useState<T>(initial: T | (() => T)): [T, (next: Update<T>) => void];
export function useEffect(effect: Effect, inputs?: unknown[]): void;
export function useLayoutEffect(effect: Effect, inputs?: unknown[]): void;
export function useRef(initial: null): { current: any };
export function useRef<T>(initial: T): { current: T };
export function useMemo<T>(make: () => T, inputs: unknown[]): T;
export function useCallback<T>(callback: T, inputs: unknown[]): T;
