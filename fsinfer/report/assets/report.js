// Tables that sort, and one picked tree shown in map, table, card and cloud alike.
(function () {
  'use strict';
  document.querySelectorAll('table.sortable').forEach(function (table) {
    var heads = table.querySelectorAll('thead th');
    heads.forEach(function (head, column) {
      head.querySelector('button').addEventListener('click', function () {
        var order = head.getAttribute('aria-sort') === 'ascending' ? -1 : 1, body = table.tBodies[0];
        heads.forEach(function (other) { other.removeAttribute('aria-sort'); });
        head.setAttribute('aria-sort', order === 1 ? 'ascending' : 'descending');
        Array.from(body.rows).sort(function (a, b) {
          var x = a.cells[column].dataset.key, y = b.cells[column].dataset.key;
          if (x === '' || y === '') { return (x === '') - (y === ''); }
          var difference = Number(x) - Number(y);
          return order * (isNaN(difference) ? x.localeCompare(y) : difference);
        }).forEach(function (row) { body.appendChild(row); });
      });
    });
  });

  var cards = Array.from(document.querySelectorAll('.card')), picked = null;
  var list = document.getElementById('choose-tree');
  function numberOf(element) { return Number(element.dataset.tree); }

  function pick(number, move) {
    picked = number;
    document.querySelectorAll('[data-tree]').forEach(function (element) {
      var own = numberOf(element) === number;
      if (element.matches('.card')) { element.classList.toggle('shown', own); }
      if (element.matches('.tree, tr')) { element.classList.toggle('picked', own); }
      if (element.matches('.tree')) { element.setAttribute('aria-pressed', String(own)); }
    });
    if (list) { list.value = String(number); }
    var said = document.querySelector('.said'), shown = document.querySelector('.card.shown');
    if (said && shown) {
      said.textContent = shown.querySelector('h3').textContent + ', ' + shown.querySelector('.dbh').textContent;
    }
    document.dispatchEvent(new CustomEvent('tree-picked', { detail: number }));
    if (move) {
      var card = document.getElementById('tree-' + number);
      // Side by side on a wide screen; on a phone the card lies below the map.
      if (card && card.getBoundingClientRect().top > window.innerHeight - 120) { card.scrollIntoView({ block: 'start' }); }
    }
  }

  function toCard(number) {
    pick(number, false);
    var part = document.getElementById('stems');
    if (part) { part.scrollIntoView({ block: 'start' }); }
    pick(number, true);
  }

  document.querySelectorAll('.map .tree').forEach(function (tree) {
    tree.addEventListener('click', function () { pick(numberOf(tree), true); });
    tree.addEventListener('keydown', function (event) {
      if (event.key === 'Enter' || event.key === ' ') { event.preventDefault(); pick(numberOf(tree), true); }
    });
  });
  document.querySelectorAll('[data-card]').forEach(function (button) {
    button.addEventListener('click', function (event) { event.preventDefault(); toCard(Number(button.dataset.card)); });
  });
  document.querySelectorAll('[data-cloud]').forEach(function (button) {
    button.addEventListener('click', function () {
      document.dispatchEvent(new CustomEvent('tree-shown', { detail: Number(button.dataset.cloud) }));
    });
  });
  document.querySelectorAll('[data-step]').forEach(function (button) {
    button.addEventListener('click', function () {
      var at = cards.findIndex(function (card) { return numberOf(card) === picked; });
      pick(numberOf(cards[(at + Number(button.dataset.step) + cards.length) % cards.length]), false);
    });
  });
  if (list) { list.addEventListener('change', function () { pick(Number(list.value), false); }); }
  // At first a tree that was measured well.
  var first = cards.find(function (card) { return card.querySelector('.status.ok'); }) || cards[0];
  if (first) { pick(numberOf(first), false); }
  // What is folded on the screen is open on paper.
  var folded = [];
  window.addEventListener('beforeprint', function () {
    folded = Array.from(document.querySelectorAll('details:not([open])'));
    folded.forEach(function (one) { one.open = true; });
  });
  window.addEventListener('afterprint', function () { folded.forEach(function (one) { one.open = false; }); });
}());
