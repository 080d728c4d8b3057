// SPDX-License-Identifier: Apache-2.0
/** Lets Node.js find /vendor/ where the dashboard serves it from: node --import ./vendored.js. */
import { registerHooks } from 'node:module';

const STATIC = new URL('../../operator/slamhive/dashboard/static', import.meta.url);

registerHooks({
  resolve: (name, context, next) =>
    name.startsWith('/vendor/') ? { url: STATIC.href + name, shortCircuit: true } : next(name, context),
});
