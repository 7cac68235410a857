// SPDX-License-Identifier: Apache-2.0
// The search finds the page before the function: a title counts most, a name in Python least.
var Scorer = {
  objNameMatch: 1,
  objPartialMatch: 0,
  objPrio: { 0: 1, 1: 0, 2: -2 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 9,
  term: 5,
  partialTerm: 2,
};
